// The embedded places and counterexamples: shares of each status by square and slice of headings.
"use strict";

const Places = (() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const { kind, free, mixed, share } = Arrays.unpackAll(data.places);
  const witnesses = Arrays.unpackAll(data.witnesses);
  const { shape: [across, up], slices, origin, size } = data.grid;
  const STATUSES = data.statuses.length;
  const rowOf = new Int32Array(across * up).fill(-1);
  mixed.forEach((square, row) => { rowOf[square] = row; });

  // Shares of the statuses in a square; of one slice, or of all headings if it is null.
  function shares(square, slice) {
    const found = new Array(STATUSES).fill(0);
    if (kind[square] < STATUSES) found[kind[square]] = 1;
    const row = rowOf[square];
    if (row < 0) return found;
    const [first, last] = slice === null ? [0, slices] : [slice, slice + 1];
    for (let at = first; at < last; at += 1) {
      for (let status = 0; status < STATUSES; status += 1) found[status] += share[(row * slices + at) * STATUSES + status];
    }
    return found.map((sum) => sum / (255 * (last - first)));
  }

  // Which part of what is free there is uncontested or certified; null where nothing free was examined.
  function safeShare([, settled, certified, refuted, unknown]) {
    const total = settled + certified + refuted + unknown;
    return total > 0 ? (settled + certified) / total : null;
  }

  function squareAt(x, y) {
    const [column, row] = [Math.floor((x - origin[0]) / size[0]), Math.floor((y - origin[1]) / size[1])];
    return column < 0 || row < 0 || column >= across || row >= up ? null : column * up + row;
  }

  // Little-endian pixels, the lowest row first. Colours are [red, green, blue].
  function picture(slice, byShare, colours) {
    const scale = data.scale.map((whole) => [(whole >> 16) & 255, (whole >> 8) & 255, whole & 255]);
    const pixels = new Uint32Array(across * up);
    for (let square = 0; square < across * up; square += 1) {
      const found = shares(square, slice);
      let colour = null;
      if (byShare) {
        const safe = free[square] ? safeShare(found) : null;
        if (safe !== null) colour = scale[Math.floor(255 * safe)];
      } else {
        const examined = found.reduce((sum, part) => sum + part, 0);
        if (examined > 0) colour = [0, 1, 2].map((channel) => found.reduce((sum, part, status) => sum + part * colours[status][channel], 0) / examined);
      }
      const [column, row] = [Math.floor(square / up), square % up];
      if (colour) pixels[row * across + column] = ((255 << 24) | (colour[2] << 16) | (colour[1] << 8) | colour[0]) >>> 0;
    }
    return { pixels, shape: [up, across] };
  }

  // From which heading to which a slice goes, in degrees.
  const headings = (slice) => [slice, slice + 1].map((end) => (360 * end) / slices - 180);

  function witness(row) {
    const vector = (name, width) => Arrays.rowOf(witnesses[name], width, row);
    return {
      pose: vector("pose", 3),
      previous: vector("previous", data.rules.lower.length),
      command: vector("action", data.rules.lower.length),
      closest: vector("closest", 3),
      seconds: witnesses.seconds[row],
      clearance: witnesses.clearance[row],
      observation: Arrays.coarseRow(data.witnesses.observation, witnesses.observation, row),
    };
  }

  // The counterexamples around a place, the worst first: of the slice if it has some; else the nearest one at all.
  function around(x, y, slice, most = 6) {
    const count = witnesses.clearance.length;
    const away = (row) => Math.hypot(witnesses.pose[3 * row] - x, witnesses.pose[3 * row + 1] - y);
    const reach = Math.max(0.25, size[0], size[1]);
    const rows = Array.from({ length: count }, (_, row) => row);
    const near = rows.filter((row) => away(row) <= reach);
    const [from, to] = slice === null ? [-Infinity, Infinity] : headings(slice).map((degrees) => (degrees * Math.PI) / 180);
    const turned = near.filter((row) => witnesses.pose[3 * row + 2] >= from && witnesses.pose[3 * row + 2] <= to);
    const chosen = (turned.length ? turned : near).sort((a, b) => witnesses.clearance[a] - witnesses.clearance[b]);
    if (chosen.length || !count) return chosen.slice(0, most);
    return [rows.reduce((best, row) => (away(row) < away(best) ? row : best))];
  }

  return { data, rules: data.rules, slices, shares, safeShare, squareAt, picture, headings, witness, around };
})();
