"use strict";
// A click on a figure opens it large; the wheel zooms about the pointer, dragging moves, a double click resets.
(function () {
  const dialog = document.querySelector("dialog");
  const stage = dialog.querySelector("div");
  document.querySelectorAll("figure svg.plot").forEach(function (plot) {
    plot.addEventListener("click", function () {
      const large = plot.cloneNode(true);
      const home = large.getAttribute("viewBox").split(" ").map(Number);
      let box = home.slice();
      let drag = null;
      const show = function () { large.setAttribute("viewBox", box.join(" ")); };
      const locate = function (event) {
        const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(large.getScreenCTM().inverse());
        return [point.x, point.y];
      };
      large.addEventListener("wheel", function (event) {
        event.preventDefault();
        const at = locate(event);
        const factor = Math.min(Math.exp(event.deltaY * 0.0015), home[2] / box[2]);
        box = [at[0] - (at[0] - box[0]) * factor, at[1] - (at[1] - box[1]) * factor, box[2] * factor, box[3] * factor];
        show();
      }, { passive: false });
      large.addEventListener("pointerdown", function (event) { drag = locate(event); large.setPointerCapture(event.pointerId); });
      large.addEventListener("pointerup", function () { drag = null; });
      large.addEventListener("pointermove", function (event) {
        if (!drag) { return; }
        const at = locate(event);
        box[0] += drag[0] - at[0];
        box[1] += drag[1] - at[1];
        show();
      });
      large.addEventListener("dblclick", function () { box = home.slice(); show(); });
      stage.replaceChildren(large);
      large.style.height = "calc(94vh - 60px)";
      dialog.showModal();
    });
  });
  dialog.querySelector("button").addEventListener("click", function () { dialog.close(); });
})();
