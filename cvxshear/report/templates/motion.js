"use strict";
(function () {
  const button = document.getElementById("play");
  const drawings = Array.from(document.querySelectorAll("svg.mode"), function (svg) {
    const numbers = function (name) { return svg.getAttribute(name).split(" ").map(Number); };
    return {
      sway: numbers("data-sway"), heights: numbers("data-heights"),
      columns: svg.querySelectorAll(".column"), floors: svg.querySelectorAll(".floor")
    };
  });
  const centre = {{ centre }}, half = {{ half }}, largest = {{ largest }}, period = 2000;
  let started = null;
  function draw(part) {
    for (const each of drawings) {
      const x = each.sway.map(function (value) { return centre + largest * part * value; });
      [-half, half].forEach(function (side, at) {
        each.columns[at].setAttribute("points", x.map(function (value, i) { return (value + side).toFixed(2) + "," + ({{ ground }} - {{ height }} * each.heights[i]).toFixed(2); }).join(" "));
      });
      each.floors.forEach(function (floor, i) {
        floor.setAttribute("x1", (x[i + 1] - half).toFixed(2));
        floor.setAttribute("x2", (x[i + 1] + half).toFixed(2));
      });
    }
  }
  function step(now) {
    if (started === null) { return; }
    draw(Math.cos(2 * Math.PI * (now - started) / period));
    requestAnimationFrame(step);
  }
  function stop() { started = null; draw(1); button.textContent = "Set in motion"; button.setAttribute("aria-pressed", "false"); }
  button.addEventListener("click", function () {
    if (started !== null) { stop(); return; }
    started = performance.now();
    button.textContent = "Stop";
    button.setAttribute("aria-pressed", "true");
    requestAnimationFrame(step);
  });
  window.addEventListener("beforeprint", function () { if (started !== null) { stop(); } });
  button.hidden = false;
}());
