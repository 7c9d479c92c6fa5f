// Addresses: what the page is asked to show, such as #state=1186, and the address of what it shows.
"use strict";

const Links = (() => {
  let timer = null;

  function asked() {
    const [, name = "", value = ""] = /^#([a-z-]+)=(.*)$/.exec(location.hash) ?? [];
    try {
      return [name, decodeURIComponent(value)];
    } catch {
      return ["", ""]; // no address of ours
    }
  }

  // Puts an address into the bar of the browser once what is shown has come to rest: some allow few changes a second.
  function write(address) {
    clearTimeout(timer);
    timer = setTimeout(() => {
      try {
        history.replaceState(null, "", address);
      } catch {
        // a page within a page may have no address of its own
      }
    }, 300);
  }

  // Calls the action of the name in the address, now and whenever it changes or is clicked again.
  function wire(actions) {
    const go = () => {
      const [name, value] = asked();
      if (Object.hasOwn(actions, name)) actions[name](value);
    };
    addEventListener("hashchange", () => {
      clearTimeout(timer);
      go();
    });
    document.addEventListener("click", ({ target }) => {
      const link = target.closest("a[href^='#']");
      if (link?.getAttribute("href") === location.hash) go();
    });
    go();
  }

  return { wire, write };
})();
