// The embedded states: arrays by rows, and what is known of each row.
"use strict";

const States = (() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const KINDS = { uint8: Uint8Array, uint16: Uint16Array, uint32: Uint32Array, float32: Float32Array, float64: Float64Array };

  function unpack({ kind, bytes }) {
    const text = atob(bytes);
    const raw = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i += 1) raw[i] = text.charCodeAt(i);
    return new KINDS[kind](raw.buffer);
  }

  const unpackAll = (packed) => Object.fromEntries(Object.entries(packed).map(([name, array]) => [name, unpack(array)]));
  const arrays = unpackAll(data.states);
  const witnesses = unpackAll(data.witnesses);
  const rules = data.rules;
  const entries = data.states.observation.lower.length;
  const witnessOf = new Map(Array.from(witnesses.row, (row, place) => [row, place]));

  const rowOf = (array, width, row) => Array.from(array.subarray(row * width, (row + 1) * width));

  // The reachable box as the robot carries it out; null for a state that geometry settled without bounds.
  function boxOf(row) {
    const clip = (value, axis) => Math.min(Math.max(value, rules.lower[axis]), rules.upper[axis]);
    const [lower, upper] = [rowOf(arrays.lower, 2, row), rowOf(arrays.upper, 2, row)];
    return lower.concat(upper).every(Number.isFinite) ? { lower: lower.map(clip), upper: upper.map(clip) } : null;
  }

  function witnessAt(row) {
    const place = witnessOf.get(row);
    if (place === undefined) return null;
    return {
      observation: rowOf(witnesses.observation, entries, place),
      command: rowOf(witnesses.action, 2, place),
      seconds: witnesses.seconds[place],
      pose: rowOf(witnesses.pose, 3, place),
      clearance: witnesses.clearance[place],
    };
  }

  function observationOf(row) {
    const { lower, step } = data.states.observation;
    return rowOf(arrays.observation, entries, row).map((whole, i) => lower[i] + step[i] * whole);
  }

  // Where the robot is until the new command begins to act: its pose, and its way during the dead time.
  function waiting(row) {
    const pose = rowOf(arrays.pose, 3, row);
    if (!arrays.previous || !rules.delay) return [pose];
    const held = rowOf(arrays.previous, 2, row);
    return [0, 0.25, 0.5, 0.75, 1].map((share) => Geometry.advance(pose, held, share * rules.delay));
  }

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
    poseOf: (row) => rowOf(arrays.pose, 3, row),
    verdictOf: (row) => data.verdicts[arrays.verdict[row]],
    episodeOf: (row) => data.episodes[arrays.episode[row]],
    timeOf: (row) => (data.connected ? arrays.time[row] : arrays.number[row]),
    widthOf: (row, axis) => arrays.upper[2 * row + axis] - arrays.lower[2 * row + axis],
  };
})();
