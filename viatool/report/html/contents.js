// The sections of the page by name, below its title.
"use strict";

(() => {
  const links = [...document.querySelectorAll("main h2[id]")].map((title) =>
    Object.assign(document.createElement("a"), { href: `#${title.id}`, textContent: title.dataset.short ?? title.firstChild.textContent }),
  );
  document.getElementById("contents").append(...links);
})();
