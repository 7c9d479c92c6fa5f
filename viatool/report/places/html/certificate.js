// The controls of a certificate: the slice of headings, the colours, and the place and counterexample looked at.
// Every string goes into the page as text, never as markup.
"use strict";

(() => {
  const element = (id) => document.getElementById(id);
  const { data, rules } = Places;
  const { fill, outline } = Figures;
  const percent = (share) => `${(Math.floor(share * 1000) / 10).toFixed(1)} %`;
  const textIn = (tag, text) => Object.assign(document.createElement(tag), { textContent: text });
  let place = null; // [x, y] that was clicked
  let shown = null; // the counterexample that is looked at
  let timer = null; // of what is played

  const slice = () => (Number(element("heading").value) === 0 ? null : Number(element("heading").value) - 1);

  function describeSlice() {
    if (slice() === null) return "all headings";
    const [from, to] = Places.headings(slice()).map((degrees) => `${Math.round(degrees * 10) / 10}°`);
    return `headings from ${from} to ${to}`;
  }

  // Colours of the theme in the order of the statuses, as [red, green, blue].
  function statusColours() {
    const style = getComputedStyle(document.documentElement);
    return ["wall", "settled", "safe", "unsafe", "unknown"].map((name) => {
      const text = style.getPropertyValue(`--${name}`).trim();
      return [1, 3, 5].map((start) => parseInt(text.slice(start, start + 2), 16));
    });
  }

  function drawPlaces() {
    const byShare = element("by-share").checked;
    const { pixels, shape } = Places.picture(slice(), byShare, statusColours());
    const source = Figures.model("places-source");
    const Picture = source.data.image[0].constructor;
    source.data = { image: [new Picture(pixels.buffer, shape)] };
    element("share-legend").hidden = !byShare;
    element("status-legend").hidden = byShare;
    element("slice").textContent = describeSlice();
    element("heading").setAttribute("aria-valuetext", describeSlice());
  }

  function tellPlace() {
    const square = place === null ? null : Places.squareAt(...place);
    const lines = [];
    if (square !== null) {
      lines.push(["at", `x ${place[0].toFixed(2)} m, y ${place[1].toFixed(2)} m`]);
      for (const [name, at] of slice() === null ? [["all headings", null]] : [[describeSlice(), slice()], ["all headings", null]]) {
        const found = Places.shares(square, at);
        const parts = data.statuses.map((status, i) => [status, found[i]]).filter(([, part]) => part > 0);
        const examined = parts.reduce((sum, [, part]) => sum + part, 0);
        if (examined < 0.97) parts.push(["not examined", 1 - examined]);
        lines.push([name, parts.map(([status, part]) => `${status} ${percent(part)}`).join(", ")]);
      }
    }
    element("place").replaceChildren(...lines.flatMap(([name, value]) => [textIn("dt", name), textIn("dd", value)]));
  }

  const poseText = ([x, y, theta]) => `(${x.toFixed(3)}, ${y.toFixed(3)}, ${theta.toFixed(3)} rad)`;
  const asideText = (side) => (side === undefined ? "" : `, ${side.toFixed(3)} m/s to the left`);
  const commandText = ([v, omega, side]) => `${v.toFixed(3)} m/s, ${omega.toFixed(3)} rad/s${asideText(side)}`;
  const nearText = ({ clearance, seconds }) => `${clearance.toFixed(4)} m after ${seconds.toFixed(2)} s`;

  function listWitnesses(rows) {
    element("nearby").replaceChildren(
      ...rows.map((row) => {
        const found = Places.witness(row);
        const button = Object.assign(textIn("button", poseText(found.pose)), { type: "button", className: "link" });
        button.addEventListener("click", () => showWitness(row));
        const line = document.createElement("tr");
        const first = document.createElement("td");
        first.append(button);
        line.append(first, ...[commandText(found.previous), commandText(found.command), nearText(found)].map((text) => textIn("td", text)));
        return line;
      }),
    );
  }

  function showWitness(row) {
    shown = row;
    const found = row === null ? null : Places.witness(row);
    fill("here", outline(found ? [found.pose] : []));
    Scene.drawRobot(rules, "map", found ? found.pose : null, 0.22);
    Scene.drawFan(found ? found.pose : null, data.fans, found ? found.observation : []);
    drawSituation();
    tellWhere(found);
    const facts = found
      ? [
          ["pose", poseText(found.pose)],
          ["command before", commandText(found.previous)],
          ["onnxruntime commands", commandText(found.command)],
          ["comes within", `${nearText(found)} (d_col ${rules.collision} m)`],
        ]
      : [];
    element("facts").replaceChildren(...facts.flatMap(([name, value]) => [textIn("dt", name), textIn("dd", value)]));
    element("observation").replaceChildren(...(found ? entriesOf(found.observation) : []));
  }

  function entriesOf(observation) {
    return data.channels.flatMap(({ name, unit, start, size, eps }) =>
      Array.from({ length: size }, (_, i) => {
        const cells = [size > 1 ? `${name} ${i}` : name, `${observation[start + i].toFixed(3)} ${unit}`, eps[i] ? `± ${eps[i]}` : "exact"];
        const line = document.createElement("tr");
        line.append(...cells.map((text) => textIn("td", text)));
        return line;
      }),
    );
  }

  function drawSituation() {
    const found = shown === null ? null : Places.witness(shown);
    const before = found ? Geometry.waiting(found.pose, rules.waits.map(() => found.previous), rules) : [];
    const gap = found ? Gap.of(found.closest, rules, data.world, found.clearance) : null;
    Scene.drawSituation(rules, before, found ? [found.command] : [], found ? { command: found.command, pose: found.closest } : null, gap);
    Figures.paint("unsafe", "here");
  }

  // Writes above the map which place is looked at, with a link to it that can be passed on.
  function tellWhere(found) {
    const words = found ? `from ${poseText(found.pose)}: comes within ${nearText(found)}` : "no counterexample was found there";
    const name = place === null ? "" : `place ${place.map((value) => value.toFixed(2)).join(", ")}`;
    const link = Object.assign(textIn("a", name), { href: addressOf(), title: "the address of this place" });
    element("where").replaceChildren(...(name ? [link, `, ${words}`] : [words]));
    if (timer === null) Announce.say(element("where").textContent);
  }

  const addressOf = () => (place === null ? "#explorer" : `#place=${place.map((value) => Number(value.toFixed(3))).join(",")}`);

  // The half metre squares that fail the condition that is chosen, or none.
  const failing = () => data.fails[Number(element("condition")?.value || -1)] ?? [];
  const middleOf = (square) => square.map((number) => data.side * (number + 0.5));

  function drawFailing() {
    const ends = (axis, more) => failing().map((square) => data.side * (square[axis] + more));
    fill("failing", { left: ends(0, 0), right: ends(0, 1), bottom: ends(1, 0), top: ends(1, 1) });
    const among = new Set(failing().map(String));
    for (const button of document.querySelectorAll("[data-worst]")) {
      const [x, y] = Places.witness(data.worst[button.dataset.worst]).pose;
      const square = [x, y].map((value) => Math.floor(value / data.side));
      button.closest("tr").hidden = among.size > 0 && !among.has(String(square));
    }
  }

  // The next square that fails the chosen condition, or the next of the worst places.
  let visited = -1;
  function toNextDoubtful() {
    const stops = failing().length ? failing().map(middleOf) : data.worst.map((row) => Places.witness(row).pose.slice(0, 2));
    if (!stops.length) {
      Announce.say((element("where").textContent = "no place is refuted"));
      return;
    }
    visited = (visited + 1) % stops.length;
    look(...stops[visited]);
    Links.write(addressOf());
  }

  // The next keys go on from what is shown.
  function toExplorer() {
    element("explorer").scrollIntoView();
    element("heading").focus({ preventScroll: true });
  }

  function goTo(text) {
    const [x, y] = text.split(",").map(Number);
    if (Number.isFinite(x) && Number.isFinite(y)) look(x, y);
    toExplorer();
  }

  function choose() {
    visited = -1;
    drawFailing();
  }

  function goToFailing(condition) {
    element("condition").value = condition;
    choose();
    toExplorer();
  }

  function play() {
    clearInterval(timer);
    const turn = () => (Number(element("heading").value) < Places.slices ? turnTo(Number(element("heading").value) + 1) : play());
    timer = timer === null ? setInterval(turn, 3 * Theme.pace()) : null;
    element("play").textContent = timer === null ? "Play" : "Pause";
  }

  function look(x, y) {
    place = [x, y];
    tellPlace();
    const rows = Places.around(x, y, slice());
    listWitnesses(rows);
    showWitness(rows[0] ?? null);
  }

  function showWorst(index) {
    const row = data.worst[index];
    if (row === undefined) {
      showWitness(null);
      return;
    }
    const { pose } = Places.witness(row);
    look(pose[0], pose[1]);
    showWitness(row);
  }

  function turnTo(value) {
    const slider = element("heading");
    slider.value = (value + Places.slices + 1) % (Places.slices + 1);
    drawPlaces();
    tellPlace();
    if (place !== null) listWitnesses(Places.around(...place, slice()));
  }

  function wire() {
    const slider = element("heading");
    slider.max = Places.slices;
    slider.addEventListener("input", () => turnTo(Number(slider.value)));
    const turn = (by) => () => {
      turnTo(by === null ? 0 : Number(slider.value) + by);
      Announce.say(describeSlice());
    };
    const clicks = { all: turn(null), back: turn(-1), forward: turn(1), play, doubtful: toNextDoubtful };
    for (const [id, action] of Object.entries(clicks)) element(id).addEventListener("click", action);
    Keys.wire({ n: clicks.forward, p: clicks.back, j: toNextDoubtful, space: play });
    element("condition")?.addEventListener("change", choose);
    for (const id of ["by-share", "by-status"]) element(id).addEventListener("change", drawPlaces);
    for (const id of ["near", "wide"]) element(id).addEventListener("change", drawSituation);
    for (const button of document.querySelectorAll("[data-worst]")) {
      button.addEventListener("click", () => {
        showWorst(Number(button.dataset.worst));
        Links.write(addressOf());
        toExplorer();
      });
    }
    Figures.model("map").on_event("tap", ({ x, y }) => {
      look(x, y);
      Links.write(addressOf());
    });
    Figures.model("situation").properties.inner_width.change.connect(drawSituation);
  }

  async function open() {
    await Figures.embed(JSON.parse(element("figures").textContent));
    wire();
    fill("goal", outline([data.goal]));
    fill("worst", outline(data.worst.map((row) => Places.witness(row).pose)));
    Theme.wire(() => {
      Figures.paint("unsafe");
      drawPlaces();
    });
    showWorst(0);
    Links.wire({ place: goTo, fails: goToFailing });
    document.documentElement.dataset.usable = performance.now();
    document.documentElement.dataset.whole = performance.now();
  }

  open();
})();
