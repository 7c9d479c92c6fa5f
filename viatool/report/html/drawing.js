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
      if (States.close[row] || row + 1 >= States.count || States.episode[row + 1] !== States.episode[row]) continue;
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
      const [close, driven] = [1, 0].map((kind) => some.filter((row) => States.close[row] === kind));
      fill(`close-${name}`, outline(close.map(States.poseOf)));
      fill(`dots-${name}`, outline(data.connected && level === 0 ? [] : driven.map(States.poseOf)));
    });
    fill("halo", data.connected ? stretches(rows.filter((row) => !States.danger[row])) : { x: [], y: [] });
  }

  function drawState(row) {
    drawEpisode(row === null ? null : States.episode[row]);
    fill("here", outline(row === null ? [] : [States.poseOf(row)]));
    drawFan(row);
    Scene.drawRobot(rules, "map", row === null ? null : States.poseOf(row), 0.22);
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
    const path = data.connected ? rows.filter((row) => !States.close[row]) : [];
    fill("track", outline(path.map(States.poseOf)));
    for (const axis of [0, 1]) {
      const curve = (some) => ({ x: some.map(States.timeOf), y: some.map((row) => States.widthOf(row, axis)) });
      fill(`width-line-${axis}`, curve(path));
      data.verdicts.forEach((name, level) => fill(`width-${axis}-${name}`, curve(rows.filter((row) => States.verdict[row] === level))));
    }
  }

  function drawFan(row) {
    if (row === null) Scene.drawFan(null, [], []);
    else Scene.drawFan(States.poseOf(row), data.fans, States.observationOf(row));
  }

  // Lower, middle and upper value of each part of a command: nine of v and omega.
  function nine({ lower, upper }) {
    const at = (axis, share) => lower[axis] + share * (upper[axis] - lower[axis]);
    const longer = (begun, _, axis) => begun.flatMap((command) => [0, 0.5, 1].map((share) => [...command, at(axis, share)]));
    return lower.reduce(longer, [[]]);
  }

  function drawSituation(row) {
    const box = row === null ? null : States.boxOf(row);
    const found = row === null ? null : States.witnessAt(row);
    Scene.drawSituation(rules, row === null ? [] : States.waiting(row), box ? nine(box) : [], found, row === null ? null : gapOf(row, found));
  }

  // The way to the nearest obstacle, from where the counterexample comes nearest or else from the pose.
  function gapOf(row, found) {
    const own = data.episodes[States.episode[row]];
    const shapes = { circles: [...data.world.circles, ...own.circles], polygons: [...data.world.polygons, ...own.polygons] };
    return Gap.of(found ? found.pose : States.poseOf(row), rules, shapes, found ? found.clearance : States.clearance[row]);
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
