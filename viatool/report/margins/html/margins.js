// The page of margins: which rows are shown, and the one that is looked at. It has no figure of the plotting library.
"use strict";

(() => {
  const element = (id) => document.getElementById(id);
  const rows = [...document.querySelectorAll("tr[data-address]")];
  let current = null;

  const shown = () => rows.filter((row) => !row.hidden);

  function applyFilters() {
    const condition = element("condition")?.value ?? "";
    const kinds = new Set([...document.querySelectorAll("[data-filter]:checked")].map((box) => box.dataset.filter));
    for (const row of rows) {
      const kind = /^#(\w+)=/.exec(row.dataset.address)[1];
      row.hidden = !kinds.has(kind) || (condition !== "" && !row.dataset.fails.split(" ").includes(condition));
    }
    element("shown").textContent = `${shown().length} of ${rows.length} states shown`;
  }

  function select(row) {
    current?.classList.remove("current");
    current = row;
    row.classList.add("current");
    row.scrollIntoView({ block: "nearest" });
    const heads = [...row.closest("table").querySelectorAll("thead th")].map((cell) => cell.textContent);
    const words = [...row.cells].map((cell, i) => `${heads[i]} ${cell.textContent}`).filter((_, i) => i !== 1);
    Announce.say(words.join(", "));
    element("where").textContent = `${row.closest(".scroll").getAttribute("aria-label")}: ${words.join(", ")}`;
    Links.write(row.dataset.address);
  }

  function step(by) {
    const some = shown();
    if (some.length) select(some[Math.min(Math.max(some.indexOf(current) + by, 0), some.length - 1)]);
  }

  function toNextDoubtful() {
    const some = shown();
    const doubtful = some.filter((row) => "doubtful" in row.dataset);
    const next = doubtful.find((row) => some.indexOf(row) > some.indexOf(current)) ?? doubtful[0];
    if (next) select(next);
    else Announce.say((element("where").textContent = "every shown state is proved at some error"));
  }

  function goTo(address) {
    const row = rows.find((one) => one.dataset.address === address);
    if (!row) {
      Announce.say((element("where").textContent = `${address.slice(1)} is none of the weakest states on this page`));
      element("explorer").scrollIntoView();
      return;
    }
    if (row.hidden) {
      for (const box of document.querySelectorAll("[data-filter]")) box.checked = true;
      if (element("condition")) element("condition").value = "";
      applyFilters();
    }
    row.scrollIntoView({ block: "center" });
    select(row);
  }

  function goToFailing(condition) {
    element("condition").value = condition;
    applyFilters();
    element("explorer").scrollIntoView();
  }

  for (const control of document.querySelectorAll("#condition, [data-filter]")) control.addEventListener("change", applyFilters);
  applyFilters();
  Keys.wire({ n: () => step(1), p: () => step(-1), j: toNextDoubtful });
  Links.wire({ state: (name) => goTo(`#state=${name}`), close: (name) => goTo(`#close=${name}`), fails: goToFailing });
  Theme.wire(() => {});
  document.documentElement.dataset.whole = performance.now();
})();
