// The table of readings: all of them, or those that cannot be told from the best one.
"use strict";

(() => {
  const only = document.getElementById("only-alike");
  const rows = [...document.querySelectorAll("tr[data-alike]")];
  const shown = document.getElementById("shown");

  function choose() {
    for (const row of rows) row.hidden = only.checked && row.dataset.alike !== "true";
    shown.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} readings`;
  }

  only.addEventListener("change", choose);
  choose();
  Theme.wire(() => {});
})();
