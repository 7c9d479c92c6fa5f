// The page of margins: its picture needs no script, its theme does.
"use strict";

Theme.wire(() => {});
document.documentElement.dataset.whole = performance.now();
