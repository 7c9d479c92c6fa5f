// Keys that work wherever the focus is, but where they are typed, and unless the box beside their names is off.
"use strict";

const Keys = (() => {
  const WRITTEN = "select, textarea, input:not([type=range], [type=checkbox], [type=radio])";
  const PRESSED = "a, button, summary, select, textarea, input:not([type=range])";

  function inSight(element) {
    const { top, bottom } = element.getBoundingClientRect();
    return top < innerHeight && bottom > 0;
  }

  // Actions by key; the space bar has its own only while the explorer is in sight, and else turns pages.
  function wire(actions) {
    addEventListener("keydown", (event) => {
      const { key, target } = event;
      if (!document.getElementById("keys").checked || event.ctrlKey || event.metaKey || event.altKey) return;
      const here = target instanceof Element ? target : document.body;
      if (here.matches(key === " " ? PRESSED : WRITTEN)) return;
      if (key === " " && !inSight(document.getElementById("explorer"))) return;
      const action = actions[key === " " ? "space" : key.toLowerCase()];
      if (!action) return;
      event.preventDefault();
      action();
    });
  }

  return { wire };
})();
