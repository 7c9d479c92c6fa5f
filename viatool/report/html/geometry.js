// Where commands bring the robot: the formulas of viatool/simulate/motion.py and viatool/safety/motion.py.
// Poses are [x, y, theta] in metres and radians; commands [v, omega] or [v, omega, speed to the left] in m/s and rad/s.
"use strict";

const Geometry = {
  // The exact arc of a command that is held for some seconds.
  advance([x, y, theta], [v, omega, side = 0], seconds) {
    const half = 0.5 * omega * seconds;
    const ratio = Math.abs(half) < 1e-4 ? 1 - (half * half) / 6 : Math.sin(half) / half;
    const [chord, aside] = [v * seconds * ratio, side * seconds * ratio];
    const heading = theta + half;
    const [c, s] = [Math.cos(heading), Math.sin(heading)];
    return [x + chord * c - aside * s, y + chord * s + aside * c, heading + half];
  },

  // For how long the constant command would take over the whole path; braking makes it longer.
  seconds([v, omega, side = 0], rules) {
    if (rules.deceleration === null) return rules.interval;
    return rules.interval + (0.5 * (Math.hypot(v, side) + rules.rim * Math.abs(omega))) / rules.deceleration;
  },

  path(pose, command, rules, steps = 12) {
    const whole = Geometry.seconds(command, rules);
    return Array.from({ length: steps + 1 }, (_, i) => Geometry.advance(pose, command, (whole * i) / steps));
  },

  // Where the robot is until a new command begins to act: its pose, and its way under those before, the oldest first.
  waiting(pose, held, rules) {
    const way = [pose];
    if (!held.flat().every(Number.isFinite)) return way; // some command was not recorded
    rules.waits.forEach((seconds, index) => {
      const from = way[way.length - 1];
      for (const share of [0.25, 0.5, 0.75, 1]) way.push(Geometry.advance(from, held[index], share * seconds));
    });
    return way;
  },

  // The corners of a footprint at a pose, or its one point.
  outline([x, y, theta], polygon) {
    if (!polygon.length) return [[x, y]];
    const [c, s] = [Math.cos(theta), Math.sin(theta)];
    return polygon.map(([a, b]) => [x + c * a - s * b, y + s * a + c * b]);
  },

  disc([x, y], radius, corners = 48) {
    return Array.from({ length: corners }, (_, i) => {
      const angle = (2 * Math.PI * i) / corners;
      return [x + radius * Math.cos(angle), y + radius * Math.sin(angle)];
    });
  },

  // The convex hull of points (Andrew's monotone chain).
  hull(points) {
    const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    const half = (ordered) => {
      const chain = [];
      for (const p of ordered) {
        while (chain.length > 1 && Geometry.turn(chain.at(-2), chain.at(-1), p) <= 0) chain.pop();
        chain.push(p);
      }
      return chain.slice(0, -1);
    };
    return sorted.length < 3 ? sorted : [...half(sorted), ...half(sorted.reverse())];
  },

  turn(a, b, c) {
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
  },

  // All points within a distance of the hull of points.
  widened(points, distance) {
    const hull = Geometry.hull(points);
    return distance > 0 ? Geometry.hull(hull.flatMap((point) => Geometry.disc(point, distance))) : hull;
  },
};
