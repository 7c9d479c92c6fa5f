// The controls: filters, the slider along the shown states, buttons, the theme and printing.
"use strict";

(() => {
  const element = (id) => document.getElementById(id);
  const { data } = States;
  let shown = []; // the rows that pass the filters
  let current = null; // the row that is looked at
  let opened = false; // what is shown before anybody asked is no address
  let timer = null; // of what is played

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
    Words.head(current, words);
    Drawing.drawState(current);
    Words.tell(current);
    if (current !== null && opened) Links.write(States.addressOf(current));
    if (timer === null && document.activeElement !== slider) Announce.say(words);
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
    Announce.say((element("where").textContent = "every shown state is safe, and fails nothing"));
  }

  function selectNearest({ x, y }) {
    const away = (row) => (States.pose[3 * row] - x) ** 2 + (States.pose[3 * row + 1] - y) ** 2;
    const nearest = shown.reduce((best, row, i) => (best === -1 || away(row) < away(shown[best]) ? i : best), -1);
    if (nearest >= 0) select(nearest);
  }

  function showEpisode(value) {
    element("episode").value = value;
    applyFilters();
    toExplorer();
  }

  function play() {
    clearInterval(timer);
    const advance = () => (place() < shown.length - 1 ? step(1) : play());
    timer = timer === null ? setInterval(advance, Theme.pace()) : null;
    element("play").textContent = timer === null ? "Play" : "Pause";
    if (timer === null && current !== null) Announce.say(Words.describe(current));
  }

  // Ticks every filter, so that nothing that an address asks for is hidden.
  function showAll() {
    for (const box of document.querySelectorAll("[data-filter]")) box.checked = true;
    for (const list of document.querySelectorAll("#episode, #condition")) list.value = "";
  }

  // The next keys go on from what is shown.
  function toExplorer() {
    element("explorer").scrollIntoView();
    element("slider").focus({ preventScroll: true });
  }

  function goTo(close, text) {
    const row = States.rowOf(close, Number(text));
    if (row < 0) {
      element("where").textContent = `${close ? "close place" : "state"} ${text} is not on this page`;
      Announce.say(element("where").textContent);
    } else {
      if (!shown.includes(row)) {
        showAll();
        applyFilters();
      }
      select(shown.indexOf(row));
    }
    toExplorer();
  }

  function goToPlaces(kind) {
    showAll();
    for (const box of document.querySelectorAll("[data-filter=place]")) box.checked = box.value === (kind === "close" ? "1" : "0");
    applyFilters();
    toExplorer();
  }

  function goToFailing(condition) {
    showAll();
    element("condition").value = condition;
    applyFilters();
    toExplorer();
  }

  // Episodes with the most states that are not safe first.
  function listEpisodes() {
    const { counts } = States;
    const order = data.episodes.map((_, i) => i).sort((a, b) => counts[b].unsafe - counts[a].unsafe || counts[b].unknown - counts[a].unknown || a - b);
    return order.map((i) => {
      const { number, name, outcome } = data.episodes[i];
      const found = ["unsafe", "unknown"].filter((verdict) => counts[i][verdict]).map((verdict) => `${counts[i][verdict]} ${verdict}`);
      return new Option(`${number}: ${name} (${[outcome, ...found].join(", ")})`, i);
    });
  }

  function wire() {
    const episodes = element("episode");
    episodes.append(...listEpisodes());
    for (const control of [episodes, ...document.querySelectorAll("#condition, [data-filter]")]) control.addEventListener("change", applyFilters);
    element("slider").addEventListener("input", () => select(place()));
    const clicks = { back: () => step(-1), forward: () => step(1), doubtful: toNextDoubtful, play };
    for (const [id, action] of Object.entries(clicks)) element(id).addEventListener("click", action);
    for (const id of ["near", "wide"]) element(id).addEventListener("change", () => Drawing.drawSituation(current));
    for (const button of document.querySelectorAll("[data-episode]")) {
      button.addEventListener("click", () => showEpisode(button.dataset.episode));
    }
    Keys.wire({ n: clicks.forward, p: clicks.back, j: toNextDoubtful, space: play });
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
    Links.wire({ state: (text) => goTo(0, text), close: (text) => goTo(1, text), fails: goToFailing, places: goToPlaces });
    opened = true;
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
