// From the footprint at a pose to the obstacle that is nearest: the shortest way between both, for the eye.
"use strict";

const Gap = (() => {
  const onEdge = ([x, y], [ax, ay], [bx, by]) => {
    const [dx, dy] = [bx - ax, by - ay];
    const share = dx || dy ? Math.min(Math.max(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0), 1) : 0;
    return [ax + share * dx, ay + share * dy];
  };
  const edges = (ring) => ring.map((corner, i) => [corner, ring[(i + 1) % ring.length]]);

  // The shorter of two ways; a way is where it begins, where it ends, how long it is and how large what is met there.
  const shorter = (found, from, to, away, size) => (found === null || away < found.away ? { from, to, away, size } : found);

  function nearest(outline, { circles, polygons }) {
    let found = null;
    const body = edges(outline);
    for (const [x, y, radius] of circles) {
      for (const [a, b] of body) {
        const from = onEdge([x, y], a, b);
        const far = Math.hypot(x - from[0], y - from[1]);
        const share = far > 0 ? radius / far : 0;
        found = shorter(found, from, [x + share * (from[0] - x), y + share * (from[1] - y)], far - radius, 2 * radius);
      }
    }
    for (const polygon of polygons) {
      const [across, up] = [0, 1].map((axis) => polygon.map((corner) => corner[axis]));
      const size = Math.min(Math.max(...across) - Math.min(...across), Math.max(...up) - Math.min(...up));
      for (const [c, d] of edges(polygon)) {
        for (const [a, b] of body) {
          for (const [from, to] of [[a, onEdge(a, c, d)], [b, onEdge(b, c, d)], [onEdge(c, a, b), c], [onEdge(d, a, b), d]]) {
            found = shorter(found, from, to, Math.hypot(to[0] - from[0], to[1] - from[1]), size);
          }
        }
      }
    }
    return found;
  }

  // The way from a footprint at a pose, if it is as long as the report says; else what is near is none of these shapes.
  function of(pose, rules, shapes, clearance) {
    const found = nearest(Geometry.outline(pose, rules.polygon), shapes);
    if (found === null || !(Math.abs(found.away - rules.radius - clearance) < 2e-3) || !(found.away > rules.radius)) return null;
    const [dx, dy] = [0, 1].map((axis) => (found.to[axis] - found.from[axis]) / found.away);
    return { ...found, from: [found.from[0] + rules.radius * dx, found.from[1] + rules.radius * dy], away: clearance };
  }

  return { of };
})();
