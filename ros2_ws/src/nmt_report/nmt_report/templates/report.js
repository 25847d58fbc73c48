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

// Buttons below every figure save it as SVG, and its numbers as a table (CSV).
(function () {
  const columns = ["panel", "series", "x_name", "x", "y_name", "y", "x_low", "x_high", "y_low", "y_high", "value"];
  const save = function (name, type, text) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: type }));
    link.download = name;
    link.click();
    setTimeout(function () { URL.revokeObjectURL(link.href); }, 1000);
  };
  const cell = function (value) {
    const text = value === null || value === undefined ? "" : String(value);
    return /[",\n]/.test(text) ? '"' + text.replace(/"/g, '""') + '"' : text;
  };
  const table = function (record) {
    const lines = [columns.join(",")];
    record.panels.forEach(function (panel) {
      panel.series.forEach(function (series) {
        const size = Math.max.apply(null, ["x", "y", "x_low", "y_low"].map(function (key) { return (series[key] || []).length; }));
        for (let k = 0; k < size; k += 1) {
          const fixed = { panel: panel.name, series: series.name, x_name: panel.x.name, y_name: panel.y.name };
          lines.push(columns.map(function (key) { return cell(key in fixed ? fixed[key] : (series[key] || [])[k]); }).join(","));
        }
      });
    });
    return lines.join("\n") + "\n";
  };
  const numbers = async function (element) {
    const letters = element.textContent.trim().replace(/-/g, "+").replace(/_/g, "/");
    const bytes = Uint8Array.from(atob(letters), function (letter) { return letter.charCodeAt(0); });
    const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return JSON.parse(await new Response(plain).text());
  };
  document.querySelectorAll("figure").forEach(function (figure) {
    const plot = figure.querySelector("svg.plot");
    const data = figure.querySelector('script[type="application/x-nmt-figure"]');
    if (!plot || !data) { return; }
    const bar = document.createElement("p");
    bar.className = "save";
    const add = function (label, hint, act) {
      const button = document.createElement("button");
      button.textContent = label;
      button.title = hint;
      button.addEventListener("click", act);
      bar.append(button);
    };
    add("SVG", "Save this figure", function () {
      save(figure.id + ".svg", "image/svg+xml", new XMLSerializer().serializeToString(plot));
    });
    if (window.DecompressionStream) {
      add("CSV", "Save the numbers of this figure", async function () { save(figure.id + ".csv", "text/csv", table(await numbers(data))); });
    }
    figure.append(bar);
  });
})();

// What is folded away on the screen is printed; afterwards it is folded again.
(function () {
  let opened = [];
  window.addEventListener("beforeprint", function () {
    opened = Array.from(document.querySelectorAll("details:not([open]):not(.raw)"));
    opened.forEach(function (element) { element.open = true; });
  });
  window.addEventListener("afterprint", function () { opened.forEach(function (element) { element.open = false; }); });
})();
