// The controls of missions: which one, and the interval that is looked at. Every string goes into the page as text.
"use strict";

(() => {
  const element = (id) => document.getElementById(id);
  const data = JSON.parse(element("data").textContent);
  const TONES = { proved: "safe", refuted: "unsafe", unknown: "unknown" };
  const { fill, outlines } = Figures;
  const textIn = (tag, text) => Object.assign(document.createElement(tag), { textContent: text });
  const unpacked = new Map();
  let number = 0; // of the mission that is looked at
  let timer = null; // of what is played

  const mission = () => data.missions[number];

  // The arrays of a mission, and which rows of its tube belong to each interval.
  function arrays() {
    if (!unpacked.has(number)) {
      const { tube, runs } = mission();
      const found = { ...Arrays.unpackAll(tube), paths: Arrays.unpack(runs.paths), rows: new Map() };
      found.step.forEach((step, row) => {
        if (!found.rows.has(step)) found.rows.set(step, []);
        found.rows.get(step).push(row);
      });
      found.length = runs.count ? found.paths.length / (2 * runs.count) : 0;
      let moving = found.length - 1; // the last interval at whose end some run has not long arrived
      const gone = (k) => Array.from({ length: runs.count }, (_, run) => run).every((run) => !Number.isFinite(found.paths[2 * (run * found.length + k)]));
      while (moving > 0 && gone(moving)) moving -= 1;
      found.last = Math.max(moving, ...found.rows.keys(), 0);
      unpacked.set(number, found);
    }
    return unpacked.get(number);
  }

  function boxes(rows) {
    const { lower, upper } = arrays();
    const end = (from, axis) => rows.map((row) => from[3 * row + axis]);
    return { left: end(lower, 0), right: end(upper, 0), bottom: end(lower, 1), top: end(upper, 1) };
  }

  // The square around all that is drawn of the mission, or the whole map.
  function frame() {
    if (element("wide").checked) {
      Figures.model("map").reset.emit();
      return;
    }
    const [shown, { lower, upper, paths }] = [mission(), arrays()];
    const ends = [[Infinity, -Infinity], [Infinity, -Infinity]];
    const include = (axis, value) => {
      if (Number.isFinite(value)) ends[axis] = [Math.min(ends[axis][0], value), Math.max(ends[axis][1], value)];
    };
    shown.start.forEach((value, i) => include(i % 2, value));
    shown.goal.flat().forEach((corner) => corner.forEach((value, axis) => include(axis, value)));
    paths.forEach((value, i) => include(i % 2, value));
    for (const from of [lower, upper]) from.forEach((value, i) => { if (i % 3 < 2) include(i % 3, value); });
    const half = Math.max(...ends.map(([low, high]) => (high - low) / 2));
    Figures.frame("map", ends.map(([low, high]) => (low + high) / 2), 1.15 * half + 0.2);
  }

  const place = () => Number(element("slider").value);
  const at = (run, step) => {
    const { paths, length } = arrays();
    const begin = 2 * (run * length + step);
    return [paths[begin], paths[begin + 1]];
  };

  // The places of each run up to an interval.
  function ways(step) {
    const { runs } = mission();
    return Array.from({ length: runs.count }, (_, run) => {
      const way = Array.from({ length: Math.min(step + 1, arrays().length) }, (__, k) => at(run, k));
      return way.filter(([x]) => Number.isFinite(x));
    });
  }

  function drawStep() {
    const [step, shown, { rows, length }] = [place(), mission(), arrays()];
    fill("tube", boxes(rows.get(step) ?? []));
    const showing = element("show-runs").checked;
    const driven = showing ? ways(step) : [];
    fill("ways", outlines(driven));
    const here = showing && step < length ? Array.from({ length: shown.runs.count }, (_, run) => at(run, step)) : [];
    fill("robots", Figures.outline(here.filter(([x]) => Number.isFinite(x))));
    const kept = shown.kept[step];
    fill("now", kept === null || kept === undefined ? { x: [], y: [] } : { x: [step * shown.interval], y: [kept] });
    const words = describe(step);
    const link = Object.assign(textIn("a", shown.name), { href: `#mission=${number}`, title: "the address of this mission" });
    element("where").replaceChildren(link, `, ${words}`);
    element("slider").setAttribute("aria-valuetext", words);
    if (timer === null && document.activeElement !== element("slider")) Announce.say(`${shown.name}, ${shown.verdict}, ${words}`);
  }

  function describe(step) {
    const [shown, rows] = [mission(), arrays().rows.get(step) ?? []];
    const time = `after ${(step * shown.interval).toFixed(2)} s`;
    if (step === 0) return `${time}: runs begin in the outlined box`;
    if (!rows.length) return shown.verdict === "proved" ? `${time}: every run has arrived` : `${time}: the set of runs was not followed so far`;
    const { lower, upper } = arrays();
    const range = (axis, unit) => {
      const [low, high] = [Math.min(...rows.map((row) => lower[3 * row + axis])), Math.max(...rows.map((row) => upper[3 * row + axis]))];
      return `${low.toFixed(2)} to ${high.toFixed(2)} ${unit}`;
    };
    const parts = shown.parts[step] ?? rows.length;
    return `${time}: ${parts} ${parts === 1 ? "part" : "parts"}, x ${range(0, "m")}, y ${range(1, "m")}, heading ${range(2, "rad")}`;
  }

  function series(name, values) {
    const known = values.map((value, k) => [k * mission().interval, value]).filter(([, value]) => value !== null);
    fill(name, Figures.outline(known));
  }

  function drawMission() {
    const [shown, { last, step }] = [mission(), arrays()];
    const [x0, y0, x1, y1] = shown.start;
    fill("start", { left: [x0], right: [x1], bottom: [y0], top: [y1] });
    fill("goal", outlines(shown.goal));
    const every = Array.from(step, (_, row) => row);
    fill("whole", boxes(element("show-whole").checked ? every : []));
    fill("map-circles", { x: shown.circles.map((c) => c[0]), y: shown.circles.map((c) => c[1]), radius: shown.circles.map((c) => c[2]) });
    fill("map-polygons", outlines(shown.polygons));
    fill("end", shown.end ? Figures.outline([shown.end]) : { x: [], y: [] });
    series("kept", shown.kept);
    series("driven", shown.driven);
    fill("limit", Figures.outline([[0, data.limit], [last * shown.interval, data.limit]]));
    element("verdict").textContent = shown.verdict;
    element("facts").replaceChildren(...facts(shown).flatMap(([name, value]) => [textIn("dt", name), textIn("dd", value)]));
    Figures.paint(TONES[shown.verdict], "here");
    drawStep();
  }

  function facts(shown) {
    const seconds = (time) => `${time.toFixed(1)} s`;
    return [
      ["arrival", shown.task],
      ...(shown.arrival ? [["every run arrives", `after ${seconds(shown.arrival[0])} to ${seconds(shown.arrival[1])}`]] : []),
      ...(shown.clearance === null ? [] : [[shown.verdict === "refuted" ? "left by the run" : "kept at every instant", `${shown.clearance.toFixed(3)} m`]]),
      ...(shown.reason ? [["why not proved", shown.reason]] : []),
    ];
  }

  function show(chosen) {
    number = chosen;
    element("mission").value = chosen;
    element("slider").max = arrays().last;
    element("slider").value = mission().verdict === "refuted" ? arrays().last : 0; // its runs say more than its start
    drawMission();
    frame();
  }

  const move = (by) => {
    element("slider").value = Math.min(Math.max(place() + by, 0), arrays().last);
    drawStep();
  };

  function play() {
    clearInterval(timer);
    if (timer === null && place() >= arrays().last) element("slider").value = 0;
    timer = timer === null ? setInterval(() => (place() < arrays().last ? move(1) : play()), Theme.pace()) : null;
    element("play").textContent = timer === null ? "Play" : "Pause";
  }

  // The missions that fail the condition that is chosen, or all; those that are not proved first.
  function passing() {
    const condition = element("condition")?.value ?? "";
    return data.order.filter((i) => condition === "" || data.fails[i].includes(Number(condition)));
  }

  function applyFilter() {
    const some = passing();
    element("mission").replaceChildren(...some.map((i) => new Option(`${data.missions[i].name} (${data.missions[i].verdict})`, i)));
    const condition = element("condition")?.value ?? "";
    for (const row of document.querySelectorAll("tr[data-fails]")) {
      row.hidden = condition !== "" && !row.dataset.fails.split(" ").includes(condition);
    }
    if (some.length) show(some.includes(number) ? number : some[0]);
  }

  function toNextDoubtful() {
    const some = passing();
    const [doubtful, from] = [some.filter((i) => data.missions[i].verdict !== "proved" || data.fails[i].length), some.indexOf(number)];
    const next = doubtful.find((i) => some.indexOf(i) > from) ?? doubtful[0];
    if (next === undefined) Announce.say((element("where").textContent = "every mission is proved"));
    else choose(next);
  }

  function choose(chosen) {
    show(chosen);
    Links.write(`#mission=${chosen}`);
  }

  // Shows what an address names.
  // The next keys go on from what is shown.
  function toExplorer() {
    element("explorer").scrollIntoView();
    element("slider").focus({ preventScroll: true });
  }

  function goTo(text) {
    const chosen = Number(text);
    if (!data.missions[chosen]) {
      Announce.say((element("where").textContent = `mission ${text} is not on this page`));
    } else {
      if (!passing().includes(chosen)) {
        element("condition").value = "";
        applyFilter();
      }
      show(chosen);
    }
    toExplorer();
  }

  function goToFailing(condition) {
    element("condition").value = condition;
    applyFilter();
    toExplorer();
  }

  function wire() {
    element("condition")?.addEventListener("change", applyFilter);
    element("mission").addEventListener("change", () => choose(Number(element("mission").value)));
    element("slider").addEventListener("input", drawStep);
    for (const id of ["show-whole", "show-runs"]) element(id).addEventListener("change", drawMission);
    for (const id of ["near", "wide"]) element(id).addEventListener("change", frame);
    const clicks = { play, back: () => move(-1), forward: () => move(1), doubtful: toNextDoubtful };
    for (const [id, action] of Object.entries(clicks)) element(id).addEventListener("click", action);
    Keys.wire({ n: clicks.forward, p: clicks.back, j: toNextDoubtful, space: play });
  }

  async function open() {
    await Figures.embed(JSON.parse(element("figures").textContent));
    wire();
    number = data.order[0] ?? 0;
    applyFilter();
    Links.wire({ mission: goTo, fails: goToFailing });
    Theme.wire(() => Figures.paint(data.missions.length ? TONES[mission().verdict] : "quiet"));
    document.documentElement.dataset.usable = performance.now();
    document.documentElement.dataset.whole = performance.now();
  }

  open();
})();
