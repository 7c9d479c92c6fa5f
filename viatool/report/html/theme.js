// Light and dark, and pictures of the figures for a sheet of paper.
"use strict";

const Theme = (() => {
  const root = document.documentElement;
  let painter = () => Figures.paint("quiet");

  function set(name) {
    root.dataset.theme = name;
    document.getElementById("theme").textContent = name === "dark" ? "Light" : "Dark";
    painter();
  }

  // Follows the system until the button says otherwise; `paint` brings the figures into the colours of the theme.
  function wire(paint) {
    painter = paint;
    const dark = matchMedia("(prefers-color-scheme: dark)");
    const follow = () => set(dark.matches ? "dark" : "light");
    dark.addEventListener("change", follow);
    document.getElementById("theme").addEventListener("click", () => set(root.dataset.theme === "dark" ? "light" : "dark"));
    addEventListener("beforeprint", toPaper);
    addEventListener("afterprint", fromPaper);
    follow();
  }

  // Paper is light, has pictures instead of canvases, and shows what fails the gate.
  let before = null;
  function toPaper() {
    const opened = [...document.querySelectorAll(".conditions details:not([open])")];
    before = { theme: root.dataset.theme, opened };
    for (const list of opened) list.open = true;
    set("light");
    Figures.addPictures();
  }

  function fromPaper() {
    document.querySelectorAll(".snapshot").forEach((picture) => picture.remove());
    for (const list of before?.opened ?? []) list.open = false;
    if (before) set(before.theme);
    before = null;
  }

  // Milliseconds from one state that is played to the next: fewer changes where motion is to be reduced.
  const pace = () => (matchMedia("(prefers-reduced-motion: reduce)").matches ? 600 : 100);

  const again = () => set(root.dataset.theme);

  return { wire, again, pace };
})();
