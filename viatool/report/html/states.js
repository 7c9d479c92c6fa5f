// The embedded states, and what is known of each row.
"use strict";

const States = (() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const { unpackAll, coarseRow } = Arrays;
  const arrays = unpackAll(data.states);
  const witnesses = unpackAll(data.witnesses);
  const rules = data.rules;
  const axes = rules.lower.length;
  const entries = data.states.observation.lower.length;
  const witnessOf = new Map(Array.from(witnesses.row, (row, place) => [row, place]));

  // The reachable box as the robot carries it out; null for a state that geometry settled without bounds.
  function boxOf(row) {
    const clip = (value, axis) => Math.min(Math.max(value, rules.lower[axis]), rules.upper[axis]);
    const [lower, upper] = [Arrays.rowOf(arrays.lower, axes, row), Arrays.rowOf(arrays.upper, axes, row)];
    return lower.concat(upper).every(Number.isFinite) ? { lower: lower.map(clip), upper: upper.map(clip) } : null;
  }

  function witnessAt(row) {
    const place = witnessOf.get(row);
    if (place === undefined) return null;
    return {
      observation: Arrays.rowOf(witnesses.observation, entries, place),
      command: Arrays.rowOf(witnesses.action, axes, place),
      seconds: witnesses.seconds[place],
      pose: Arrays.rowOf(witnesses.pose, 3, place),
      clearance: witnesses.clearance[place],
    };
  }

  const observationOf = (row) => coarseRow(data.states.observation, arrays.observation, row);

  // The commands on their way to the motors in a state, the oldest first.
  function heldOf(row) {
    const numbers = rules.waits.length ? Arrays.rowOf(arrays.under_way, axes * rules.waits.length, row) : [];
    return rules.waits.map((_, index) => numbers.slice(axes * index, axes * (index + 1)));
  }

  // Where the robot is until the new command begins to act: its pose, and its way during the dead time.
  function waiting(row) {
    return Geometry.waiting(Arrays.rowOf(arrays.pose, 3, row), heldOf(row), rules);
  }

  // Whether a condition of the gate, or without one any, counts a row as failing.
  const failing = Arrays.unpack(data.fails);
  function fails(row, condition = null) {
    const some = failing.subarray(data.conditions * row, data.conditions * (row + 1));
    return condition === null ? some.includes(1) : some[condition] === 1;
  }

  // The row of a state, or of a close place, by its number; -1 if the page does not hold it.
  function rowOf(close, number) {
    return arrays.number.findIndex((value, row) => value === number && arrays.close[row] === close);
  }

  // How many states of each episode have each verdict.
  const counts = data.episodes.map(() => Object.fromEntries(data.verdicts.map((name) => [name, 0])));
  arrays.verdict.forEach((verdict, row) => { counts[arrays.episode[row]][data.verdicts[verdict]] += 1; });

  function rowsOfEpisode(episode) {
    const rows = [];
    for (let row = 0; row < arrays.verdict.length; row += 1) if (arrays.episode[row] === episode) rows.push(row);
    return rows;
  }

  return {
    ...arrays,
    data,
    rules,
    count: arrays.verdict.length,
    boxOf,
    witnessAt,
    observationOf,
    waiting,
    rowsOfEpisode,
    rowOf,
    counts,
    fails,
    nameOf: (row) => `${arrays.close[row] ? "close place" : "state"} ${arrays.number[row]}`,
    addressOf: (row) => `#${arrays.close[row] ? "close" : "state"}=${arrays.number[row]}`,
    poseOf: (row) => Arrays.rowOf(arrays.pose, 3, row),
    verdictOf: (row) => data.verdicts[arrays.verdict[row]],
    episodeOf: (row) => data.episodes[arrays.episode[row]],
    timeOf: (row) => (data.connected ? arrays.time[row] : arrays.number[row]),
    widthOf: (row, axis) => arrays.upper[axes * row + axis] - arrays.lower[axes * row + axis],
  };
})();
