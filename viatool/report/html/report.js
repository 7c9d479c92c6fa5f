// The controls: filters, the slider along the shown states, buttons, the theme and printing.
"use strict";

(() => {
  const element = (id) => document.getElementById(id);
  const { data } = States;
  let shown = []; // the rows that pass the filters
  let current = null; // the row that is looked at

  function passing() {
    const ticked = (kind) => new Set([...document.querySelectorAll(`[data-filter=${kind}]:checked`)].map((box) => box.value));
    const [verdicts, outcomes, episode] = [ticked("verdict"), ticked("outcome"), element("episode").value];
    const places = ticked("place");
    const placePasses = (row) => !document.querySelector("[data-filter=place]") || places.has(String(States.close[row]));
    const condition = element("condition")?.value ?? "";
    const gatePasses = (row) => condition === "" || States.fails(row, Number(condition));
    const verdictPasses = data.verdicts.map((name) => verdicts.has(name));
    const episodePasses = data.episodes.map(({ outcome }, i) => outcomes.has(outcome) && (episode === "" || Number(episode) === i));
    const rows = [];
    for (let row = 0; row < States.count; row += 1) {
      if (verdictPasses[States.verdict[row]] && episodePasses[States.episode[row]] && placePasses(row) && gatePasses(row)) rows.push(row);
    }
    return rows;
  }

  function applyFilters() {
    shown = passing();
    const slider = element("slider");
    slider.max = Math.max(shown.length - 1, 0);
    slider.disabled = shown.length === 0;
    const [some, all] = [shown.length, States.count].map((number) => number.toLocaleString("en"));
    element("shown").textContent = `${some} of ${all} states ${States.close.includes(1) ? "and close places " : ""}shown`;
    Drawing.drawMap(shown);
    select(Math.max(shown.indexOf(current), 0));
  }

  function select(place) {
    current = shown[place] ?? null;
    const words = current === null ? "no state passes the filters" : Words.describe(current);
    const slider = element("slider");
    slider.value = place;
    slider.setAttribute("aria-valuetext", words);
    element("where").textContent = words;
    Drawing.drawState(current);
    Words.tell(current);
  }

  const place = () => Number(element("slider").value);
  const step = (by) => select(Math.min(Math.max(place() + by, 0), Math.max(shown.length - 1, 0)));

  function toNextDoubtful() {
    for (let ahead = 1; ahead <= shown.length; ahead += 1) {
      const next = (place() + ahead) % shown.length;
      if (States.verdict[shown[next]] > 0 || States.fails(shown[next])) {
        select(next);
        return;
      }
    }
    element("where").textContent = "every shown state is safe, and fails nothing";
  }

  function selectNearest({ x, y }) {
    const away = (row) => (States.pose[3 * row] - x) ** 2 + (States.pose[3 * row + 1] - y) ** 2;
    const nearest = shown.reduce((best, row, i) => (best === -1 || away(row) < away(shown[best]) ? i : best), -1);
    if (nearest >= 0) select(nearest);
  }

  function showEpisode(value) {
    element("episode").value = value;
    applyFilters();
    element("explorer").scrollIntoView();
    element("slider").focus();
  }

  let timer = null;
  function play() {
    clearInterval(timer);
    const advance = () => (place() < shown.length - 1 ? step(1) : play());
    timer = timer === null ? setInterval(advance, 100) : null;
    element("play").textContent = timer === null ? "Play" : "Pause";
  }

  function wire() {
    const episodes = element("episode");
    episodes.append(...data.episodes.map(({ number, name, outcome }, i) => new Option(`${number}: ${name} (${outcome})`, i)));
    for (const control of [episodes, ...document.querySelectorAll("#condition, [data-filter]")]) control.addEventListener("change", applyFilters);
    element("slider").addEventListener("input", () => select(place()));
    const clicks = { back: () => step(-1), forward: () => step(1), doubtful: toNextDoubtful, play };
    for (const [id, action] of Object.entries(clicks)) element(id).addEventListener("click", action);
    for (const id of ["near", "wide"]) element(id).addEventListener("change", () => Drawing.drawSituation(current));
    for (const button of document.querySelectorAll("[data-episode]")) {
      button.addEventListener("click", () => showEpisode(button.dataset.episode));
    }
    Figures.model("map").on_event("tap", selectNearest);
    Figures.model("situation").properties.inner_width.change.connect(() => Drawing.drawSituation(current));
  }

  // The explorer first, and the figures below it when the page can already be used.
  async function open() {
    const items = JSON.parse(element("figures").textContent);
    await Figures.embed(items.slice(0, 3));
    wire();
    current = data.first;
    applyFilters();
    Theme.wire(() => Figures.paint(current === null ? "quiet" : States.verdictOf(current)));
    document.documentElement.dataset.usable = performance.now();
    await new Promise((resolve) => { setTimeout(resolve, 50); });
    await Figures.embed(items.slice(3));
    Drawing.redraw(current);
    Theme.again();
    document.documentElement.dataset.whole = performance.now();
  }

  open();
})();
