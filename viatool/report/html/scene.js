// What is drawn of one state wherever it comes from: the robot, its LiDAR, and what its commands sweep.
"use strict";

const Scene = (() => {
  const { fill, outline, outlines } = Figures;

  // What each LiDAR reads from a pose, a wedge for each number of the observation; nothing without a pose.
  function drawFan(pose, fans, observation) {
    const fan = { x: [], y: [], radius: [], start: [], end: [] };
    for (const { start, right, left, scale, offset, reciprocal } of pose === null ? [] : fans) {
      right.forEach((edge, bin) => {
        const reading = (observation[start + bin] - offset) / scale;
        fan.x.push(pose[0]);
        fan.y.push(pose[1]);
        fan.radius.push(Math.max(reciprocal ? 1 / reading : reading, 0));
        fan.start.push(pose[2] + edge);
        fan.end.push(pose[2] + left[bin]);
      });
    }
    fill("fan", fan);
  }

  function drawRobot(rules, figure, pose, size) {
    const arrow = [[1, 0], [-0.6, 0.55], [-0.3, 0], [-0.6, -0.55]].map(([a, b]) => [size * a, size * b]);
    fill(`${figure}-robot`, outline(pose === null ? [] : Geometry.outline(pose, arrow)));
    const body = pose === null || (!rules.radius && !rules.polygon.length) ? [] : Geometry.outline(pose, rules.polygon);
    fill(`${figure}-footprint`, outline(body.length ? Geometry.widened(body, rules.radius) : []));
  }

  // The way before the command acts (at least the pose), the paths of its commands, a counterexample or null, and the
  // way to the nearest obstacle or null.
  function drawSituation(rules, before, commands, found, gap) {
    const arcs = commands.map((command) => Geometry.path(before.at(-1), command, rules));
    const swept = [...before, ...arcs.flat()].flatMap((pose) => Geometry.outline(pose, rules.polygon));
    const tube = (distance) => (arcs.length ? Geometry.widened(swept, rules.radius + distance) : []);
    fill("danger-tube", outline(tube(rules.danger)));
    fill("collision-tube", outline(tube(rules.collision)));
    fill("swept", outline(tube(0)));
    fill("arcs", outlines(arcs));
    fill("arc-ends", outline(arcs.map((arc) => arc.at(-1))));
    fill("witness-path", outline(found ? [...before, ...Geometry.path(before.at(-1), found.command, rules)] : []));
    fill("witness-pose", outline(found ? [found.pose] : []));
    drawGap(gap);
    if (!before.length) return;
    const reach = Math.max(0.05, ...swept.map(([x, y]) => Math.hypot(x - swept[0][0], y - swept[0][1])));
    drawRobot(rules, "situation", before[0], Math.min(0.16 * reach, 0.1));
    look(rules, before[0], reach, gap);
  }

  const length = (metres) => (metres < 0.01 ? `${Number((metres * 1000).toPrecision(2))} mm` : metres < 1 ? `${Number((metres * 100).toPrecision(3))} cm` : `${Number(metres.toPrecision(3))} m`);

  function drawGap(gap) {
    fill("gap", outline(gap ? [gap.from, gap.to] : []));
    const middle = gap ? [0, 1].map((axis) => (gap.from[axis] + gap.to[axis]) / 2) : [];
    fill("gap-text", { x: middle.slice(0, 1), y: middle.slice(1), text: gap ? [`${(Math.floor(gap.away * 10000) / 100).toFixed(2)} cm`] : [] });
  }

  // The near view shows the arcs, the wide one the tubes and the obstacle that is nearest, as far as it can be seen whole.
  function look(rules, [x, y, theta], reach, gap) {
    const near = document.getElementById("near").checked;
    const around = rules.danger + rules.radius + reach;
    const ends = [x, y].map((value) => [value - around, value + around]);
    if (gap) {
      const beyond = Math.min(gap.size, 0.8 * around) / Math.max(gap.away, 1e-9);
      ends.forEach((pair, axis) => {
        const far = gap.to[axis] + beyond * (gap.to[axis] - gap.from[axis]);
        [pair[0], pair[1]] = [Math.min(pair[0], far), Math.max(pair[1], far)];
      });
    }
    const half = near ? 0.8 * reach : 0.54 * Math.max(...ends.map(([low, high]) => high - low));
    const [a, b] = near ? [x + 0.4 * reach * Math.cos(theta), y + 0.4 * reach * Math.sin(theta)] : ends.map(([low, high]) => (low + high) / 2);
    Figures.frame("situation", [a, b], half);
    const bar = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5].findLast((size) => size <= 0.7 * half);
    const [left, low] = [a - 0.9 * half, b - 0.92 * half];
    fill("scale-bar", { x: [left, left + bar], y: [low, low] });
    fill("scale-text", { x: [left + bar / 2], y: [low + 0.02 * half], text: [length(bar)] });
  }

  return { drawFan, drawRobot, drawSituation };
})();
