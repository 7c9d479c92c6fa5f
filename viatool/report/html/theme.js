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
    addEventListener("beforeprint", Figures.addPictures);
    addEventListener("afterprint", () => document.querySelectorAll(".snapshot").forEach((picture) => picture.remove()));
    follow();
  }

  const again = () => set(root.dataset.theme);

  return { wire, again };
})();
