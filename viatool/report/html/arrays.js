// Embedded arrays: little-endian bytes in base64, by rows.
"use strict";

const Arrays = (() => {
  const KINDS = { uint8: Uint8Array, uint16: Uint16Array, uint32: Uint32Array, float32: Float32Array, float64: Float64Array };

  function unpack({ kind, bytes }) {
    const text = atob(bytes);
    const raw = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i += 1) raw[i] = text.charCodeAt(i);
    return new KINDS[kind](raw.buffer);
  }

  const unpackAll = (packed) => Object.fromEntries(Object.entries(packed).map(([name, array]) => [name, unpack(array)]));
  const rowOf = (array, width, row) => Array.from(array.subarray(row * width, (row + 1) * width));

  // A row of numbers that were packed as 16-bit steps.
  const coarseRow = ({ lower, step }, array, row) => rowOf(array, lower.length, row).map((whole, i) => lower[i] + step[i] * whole);

  return { unpack, unpackAll, rowOf, coarseRow };
})();
