// What is said aloud by screen readers: the last of several changes, when it has come to rest.
"use strict";

const Announce = (() => {
  let timer = null;

  function say(text) {
    clearTimeout(timer);
    timer = setTimeout(() => { document.getElementById("said").textContent = text; }, 300);
  }

  return { say };
})();
