// What the page says of a state. Every string goes into the page as text, never as markup.
"use strict";

const Words = (() => {
  const { data, rules } = States;
  const textIn = (tag, text) => Object.assign(document.createElement(tag), { textContent: text });
  const number = (value, digits = 4) => Number(value.toPrecision(digits)).toString();
  const reasons = new Map(data.reasons);
  const signed = (value) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(3)}`;

  function describe(row) {
    const { name, outcome } = States.episodeOf(row);
    const when = data.connected ? `t = ${States.time[row].toFixed(2)} s` : `goal of ${name}`;
    const where = data.connected ? `${name} (${outcome}), ${when}` : when;
    return `${States.nameOf(row)}, ${where}: ${States.verdictOf(row)}`;
  }

  // Writes above the figures which state is shown, with a link to it that can be passed on.
  function head(row, words) {
    const name = row === null ? "" : States.nameOf(row);
    const link = Object.assign(textIn("a", name), { href: row === null ? "#explorer" : States.addressOf(row), title: "the address of this state" });
    document.getElementById("where").replaceChildren(...(row === null ? [words] : [link, words.slice(name.length)]));
  }

  // Pairs of a name and a value.
  function factsOf(row) {
    const [box, found, [x, y, theta]] = [States.boxOf(row), States.witnessAt(row), States.poseOf(row)];
    const facts = [
      ["pose", `x ${x.toFixed(3)} m, y ${y.toFixed(3)} m, heading ${theta.toFixed(3)} rad`],
      ["clearance there", `${States.clearance[row].toFixed(4)} m (d_col ${rules.collision} m, d_danger ${rules.danger} m)`],
      ["at d_col", `${States.verdictOf(row)}; the nine samples ${States.sampled[row] ? "pass" : "fail"}`],
      ["at d_danger", States.danger[row] ? "proved" : "not proved"],
      ["contested", `${States.contested[row] ? "yes: some" : "no: no"} command of the robot could make it fail`],
    ];
    if (reasons.has(row)) facts.unshift(["why", reasons.get(row)]);
    data.actions.forEach(({ name, unit }, axis) => {
      const range = box ? `${number(box.lower[axis], 6)} to ${number(box.upper[axis], 6)} ${unit}` : "not bounded: geometry alone settles this state";
      facts.push([name, box ? `${range}, width ${number(States.widthOf(row, axis), 3)}` : range]);
    });
    if (found) {
      const [v, omega, side] = found.command;
      const aside = side === undefined ? "" : `, to the left ${number(side, 6)}`;
      facts.push(["counterexample", `onnxruntime commands v ${number(v, 6)}, ω ${number(omega, 6)}${aside}; ${found.clearance.toFixed(6)} m are left after ${found.seconds.toFixed(3)} s`]);
    }
    return facts;
  }

  // One line for each entry of the observation.
  function entriesOf(row) {
    const [observation, found] = [States.observationOf(row), States.witnessAt(row)];
    return data.channels.flatMap(({ name, unit, start, size, eps }) =>
      Array.from({ length: size }, (_, i) => [
        size > 1 ? `${name} ${i}` : name,
        `${observation[start + i].toFixed(3)} ${unit}`,
        eps[i] ? `± ${number(eps[i])}` : "exact",
        found ? signed(found.observation[start + i] - observation[start + i]) : "",
      ]),
    );
  }

  function tell(row) {
    const facts = row === null ? [] : factsOf(row);
    document.getElementById("facts").replaceChildren(...facts.flatMap(([name, value]) => [textIn("dt", name), textIn("dd", value)]));
    const lines = row === null ? [] : entriesOf(row);
    const body = document.getElementById("observation");
    body.replaceChildren(
      ...lines.map((cells) => {
        const line = document.createElement("tr");
        line.append(...cells.map((text) => textIn("td", text)));
        return line;
      }),
    );
  }

  return { describe, head, tell };
})();
