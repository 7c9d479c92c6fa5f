// The figures of the plotting library: found by name, filled with columns, painted in the colours of the theme.
"use strict";

const Figures = (() => {
  const views = {};
  const models = new Map();
  const themed = []; // [model, property, name of a colour], as the tags of the models ask for

  async function embed(items) {
    for (const item of items) {
      const [view] = [...(await Bokeh.embed.embed_item(item))];
      views[view.model.name] = view;
      for (const layer of [view.canvas_view.primary, view.canvas_view.overlays]) layer.clear = () => clearWhole(layer);
      for (const model of view.model.document.all_models) {
        if (model.name) models.set(model.name, model);
        for (const { theme } of model.tags) {
          for (const [property, name] of Object.entries(theme)) themed.push([model, property, name]);
        }
      }
    }
    await twoFrames();
  }

  // The library's own leaves the first half pixel, and so a trace of what was there.
  function clearWhole({ ctx, bbox }) {
    ctx.clearRect(-1, -1, bbox.width + 2, bbox.height + 2);
  }

  // What is drawn on an overlay before the figure knows its size leaves a trace at the edge.
  const twoFrames = () => new Promise((resolve) => { requestAnimationFrame(() => requestAnimationFrame(resolve)); });

  // Columns for a source; a figure that is not there yet is filled when it comes.
  function fill(name, columns) {
    const source = models.get(`${name}-source`);
    if (source) source.data = columns;
  }

  const outline = (points) => ({ x: points.map((p) => p[0]), y: points.map((p) => p[1]) });
  const outlines = (list) => ({ x: list.map((ps) => ps.map((p) => p[0])), y: list.map((ps) => ps.map((p) => p[1])) });

  // Shows a square around a point, with the same scale on both axes whatever the size of the figure.
  function frame(name, [x, y], half) {
    const { inner_width: width, inner_height: height, x_range, y_range } = models.get(name);
    const ratio = width > 0 && height > 0 ? width / height : 1;
    const [across, up] = [half * Math.max(ratio, 1), half * Math.max(1 / ratio, 1)];
    x_range.setv({ start: x - across, end: x + across });
    y_range.setv({ start: y - up, end: y + up });
  }

  // Paints what takes a colour of the theme, or only what takes the one of that name; `here` is the verdict shown.
  function paint(here, only = null) {
    const style = getComputedStyle(document.documentElement);
    for (const [model, property, name] of themed) {
      if (only !== null && name !== only) continue;
      const wanted = style.getPropertyValue(`--${name === "here" ? here : name}`).trim();
      const given = model[property];
      if (given === null || typeof given !== "object") model[property] = wanted;
      else if (given.value !== wanted) model[property] = { value: wanted };
    }
  }

  // Canvases do not follow the width of a sheet of paper: pictures of them do. Marks would take up new colours only later.
  function addPictures() {
    for (const view of Object.values(views)) {
      for (const part of view.renderer_views.values()) part.set_visuals?.();
      const picture = document.createElement("img");
      picture.className = "snapshot";
      picture.alt = view.el.parentElement.getAttribute("aria-label");
      picture.src = view.export("png", true).canvas.toDataURL();
      view.el.parentElement.append(picture);
    }
  }

  return { embed, fill, outline, outlines, frame, paint, addPictures, model: (name) => models.get(name) };
})();
