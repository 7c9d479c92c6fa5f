// What the figures show: the run on the map, and the state that is looked at.
"use strict";

const Drawing = (() => {
  const { data, rules } = States;
  const { fill, outline, outlines } = Figures;
  let episodeShown = null; // whose obstacles, track and widths are drawn

  // Lines along consecutive states; a stretch belongs to the state in which it starts.
  function stretches(rows) {
    const lines = { x: [], y: [] };
    const add = (row) => {
      lines.x.at(-1).push(States.pose[3 * row]);
      lines.y.at(-1).push(States.pose[3 * row + 1]);
    };
    let end = null;
    for (const row of rows) {
      if (row + 1 >= States.count || States.episode[row + 1] !== States.episode[row]) continue;
      if (row !== end) {
        lines.x.push([]);
        lines.y.push([]);
        add(row);
      }
      end = row + 1;
      add(end);
    }
    return lines;
  }

  function drawMap(rows) {
    data.verdicts.forEach((name, level) => {
      const some = rows.filter((row) => States.verdict[row] === level);
      fill(`path-${name}`, data.connected ? stretches(some) : { x: [], y: [] });
      fill(`dots-${name}`, outline(data.connected && level === 0 ? [] : some.map(States.poseOf)));
    });
    fill("halo", data.connected ? stretches(rows.filter((row) => !States.danger[row])) : { x: [], y: [] });
  }

  function drawState(row) {
    drawEpisode(row === null ? null : States.episode[row]);
    fill("here", outline(row === null ? [] : [States.poseOf(row)]));
    drawFan(row);
    drawRobot("map", row, 0.22);
    drawSituation(row);
    drawCommands(row);
    for (const axis of [0, 1]) {
      const now = Figures.model(`now-${axis}`);
      if (now) now.location = row === null ? null : States.timeOf(row);
    }
    Figures.paint(row === null ? "quiet" : States.verdictOf(row), "here");
  }

  // What stays the same along an episode: obstacles, goal, track and widths.
  function drawEpisode(episode) {
    if (episode === episodeShown) return;
    episodeShown = episode;
    const { circles, polygons, goal } = episode === null ? { circles: [], polygons: [], goal: null } : data.episodes[episode];
    const [x, y, radius] = [0, 1, 2].map((i) => circles.map((circle) => circle[i]));
    for (const name of ["map", "situation"]) {
      fill(`${name}-circles`, { x, y, radius });
      fill(`${name}-polygons`, outlines(polygons));
    }
    fill("goal", outline(goal ? [goal] : []));
    const rows = States.rowsOfEpisode(episode);
    fill("track", outline(data.connected ? rows.map(States.poseOf) : []));
    for (const axis of [0, 1]) {
      const curve = (some) => ({ x: some.map(States.timeOf), y: some.map((row) => States.widthOf(row, axis)) });
      fill(`width-line-${axis}`, curve(data.connected ? rows : []));
      data.verdicts.forEach((name, level) => fill(`width-${axis}-${name}`, curve(rows.filter((row) => States.verdict[row] === level))));
    }
  }

  function drawFan(row) {
    const fan = { x: [], y: [], radius: [], start: [], end: [] };
    if (row !== null && data.fan) {
      const { start, bins, view } = data.fan;
      const [[x, y, theta], observation] = [States.poseOf(row), States.observationOf(row)];
      for (let bin = 0; bin < bins; bin += 1) {
        fan.x.push(x);
        fan.y.push(y);
        fan.radius.push(Math.max(observation[start + bin], 0));
        fan.start.push(theta - view / 2 + (view * bin) / bins);
        fan.end.push(theta - view / 2 + (view * (bin + 1)) / bins);
      }
    }
    fill("fan", fan);
  }

  function drawRobot(figure, row, size) {
    const arrow = [[1, 0], [-0.6, 0.55], [-0.3, 0], [-0.6, -0.55]].map(([a, b]) => [size * a, size * b]);
    fill(`${figure}-robot`, outline(row === null ? [] : Geometry.outline(States.poseOf(row), arrow)));
    const body = row === null || (!rules.radius && !rules.polygon.length) ? [] : Geometry.outline(States.poseOf(row), rules.polygon);
    fill(`${figure}-footprint`, outline(body.length ? Geometry.widened(body, rules.radius) : []));
  }

  // Lower, middle and upper value of both commands.
  function nine({ lower, upper }) {
    const at = (axis, share) => lower[axis] + share * (upper[axis] - lower[axis]);
    return [0, 0.5, 1].flatMap((v) => [0, 0.5, 1].map((omega) => [at(0, v), at(1, omega)]));
  }

  function drawSituation(row) {
    const box = row === null ? null : States.boxOf(row);
    const found = row === null ? null : States.witnessAt(row);
    const before = row === null ? [] : States.waiting(row);
    const arcs = box ? nine(box).map((command) => Geometry.path(before.at(-1), command, rules)) : [];
    const swept = [...before, ...arcs.flat()].flatMap((pose) => Geometry.outline(pose, rules.polygon));
    const tube = (distance) => (box ? Geometry.widened(swept, rules.radius + distance) : []);
    fill("danger-tube", outline(tube(rules.danger)));
    fill("collision-tube", outline(tube(rules.collision)));
    fill("swept", outline(tube(0)));
    fill("arcs", outlines(arcs));
    fill("arc-ends", outline(arcs.map((arc) => arc.at(-1))));
    fill("witness-path", outline(found ? [...before, ...Geometry.path(before.at(-1), found.command, rules)] : []));
    fill("witness-pose", outline(found ? [found.pose] : []));
    if (row === null) return;
    const reach = Math.max(0.05, ...swept.map(([x, y]) => Math.hypot(x - swept[0][0], y - swept[0][1])));
    drawRobot("situation", row, Math.min(0.16 * reach, 0.1));
    look(States.poseOf(row), reach);
  }

  // The near view shows the arcs, the wide one the tubes and the obstacles around them.
  function look([x, y, theta], reach) {
    const near = document.getElementById("near").checked;
    const ahead = near ? 0.4 * reach : 0;
    const half = near ? 0.8 * reach : 1.15 * (rules.danger + rules.radius + reach);
    const [a, b] = [x + ahead * Math.cos(theta), y + ahead * Math.sin(theta)];
    Figures.frame("situation", [a, b], half);
    const length = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5].findLast((size) => size <= 0.7 * half);
    const [left, low] = [a - 0.9 * half, b - 0.92 * half];
    fill("scale-bar", { x: [left, left + length], y: [low, low] });
    const text = length < 0.01 ? `${length * 1000} mm` : length < 1 ? `${Math.round(length * 100)} cm` : `${length} m`;
    fill("scale-text", { x: [left + length / 2], y: [low + 0.02 * half], text: [text] });
  }

  function drawCommands(row) {
    const box = row === null ? null : States.boxOf(row);
    const found = row === null ? null : States.witnessAt(row);
    const rectangle = ({ lower, upper }) => ({ left: [lower[0]], right: [upper[0]], bottom: [lower[1]], top: [upper[1]] });
    fill("limits", rectangle(rules));
    fill("box", box ? rectangle(box) : { left: [], right: [], bottom: [], top: [] });
    const samples = box ? nine(box) : [];
    fill("nine", { v: samples.map((c) => c[0]), omega: samples.map((c) => c[1]) });
    fill("witness-command", { v: found ? [found.command[0]] : [], omega: found ? [found.command[1]] : [] });
    const { lower, upper } = box ?? rules;
    const { x_range, y_range } = Figures.model("commands");
    [x_range, y_range].forEach((range, axis) => {
      const margin = Math.max(0.3 * (upper[axis] - lower[axis]), 0.004 * (rules.upper[axis] - rules.lower[axis]));
      range.setv({ start: lower[axis] - margin, end: upper[axis] + margin });
    });
  }

  // Draws a state anew when figures have been added.
  function redraw(row) {
    episodeShown = undefined;
    drawState(row);
  }

  return { drawMap, drawState, drawSituation, redraw };
})();
