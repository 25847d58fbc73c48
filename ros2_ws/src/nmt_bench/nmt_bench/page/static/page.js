// Draws what the server sends. Frames: see nmt_bench/page/frames.py.
"use strict";
(function () {
  const get = (id) => document.getElementById(id);
  const role = document.body.dataset.role;
  const decoder = new TextDecoder();
  let facts = null, factArrays = {}, live = null, liveArrays = {}, heardAt = 0, drawn = -1, factsChanged = false, shownPhase = "";
  let slow = {}, strips = null, channelRows = [], answerTimer = 0;

  // -- frames --------------------------------------------------------------------------------------------------------

  function readFrame(buffer) {
    const view = new DataView(buffer);
    if (view.byteLength < 8 || decoder.decode(new Uint8Array(buffer, 0, 4)) !== "NMT1") { return null; }
    const length = view.getUint32(4, true);
    const head = JSON.parse(decoder.decode(new Uint8Array(buffer, 8, length)));
    const arrays = {};
    let position = 8 + length;
    for (const [name, size] of head.arrays) {
      arrays[name] = new Float32Array(buffer, position, size);
      position += 4 * size;
    }
    return [head, arrays];
  }

  function connect() {
    const socket = new WebSocket("ws://" + location.host + "/live");
    socket.binaryType = "arraybuffer";
    socket.onmessage = (event) => {
      const frame = readFrame(event.data);
      if (!frame) { return; }
      heardAt = performance.now();
      const [head, arrays] = frame;
      if (head.kind === "facts") {
        const other = facts && (facts.run !== head.run || facts.strip_seconds !== head.strip_seconds || facts.channels.length !== head.channels.length);
        facts = head; factArrays = arrays; factsChanged = true;
        if (other || !strips) { strips = null; }
      } else if (head.kind === "live") {
        live = head; liveArrays = arrays;
        for (const name in arrays) {
          if (/^(spectrum|harmonics|frf|coherence|averages|track)/.test(name)) { slow[name] = arrays[name]; slow.changed = true; }
        }
        if ("fundamental" in head) { slow.fundamental = head.fundamental; }
        takeStrips();
      } else if (head.kind === "player") {
        showPlayer(head);
      }
    };
    socket.onclose = () => { setTimeout(connect, 1000); };
  }

  function takeStrips() {
    if (!facts || !live.strips || !facts.strip_stretches) { return; }
    const size = facts.strip_stretches;
    const count = live.strips.length;
    if (!strips || strips.low.length !== count || (strips.newest > live.strips[0] + size)) {
      const empty = () => Array.from({ length: count }, () => new Float32Array(size).fill(NaN));
      strips = { low: empty(), high: empty(), newest: -1 };
    }
    for (let n = 0; n < count; n++) {
      const first = live.strips[n], low = liveArrays["low" + n], high = liveArrays["high" + n];
      for (let k = 0; k < low.length; k++) {
        strips.low[n][(first + k) % size] = low[k];
        strips.high[n][(first + k) % size] = high[k];
      }
      if (n === 0 && low.length) { strips.newest = first + low.length - 1; }
    }
  }

  // -- plots ---------------------------------------------------------------------------------------------------------

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const COLOURS = ["blue", "orange", "green", "purple", "sky", "grey", "red", "warn"];
  const DASHES = [[], [8, 4], [2, 3], [10, 3, 2, 3], [], [6, 6], [3, 3], [12, 4]];
  const plots = {};

  // The page's own size of letters, which grows with the screen.
  const letter = () => 0.8 * parseFloat(getComputedStyle(document.documentElement).fontSize);
  // As wide as its longest number.
  const axisSize = (chart, words, number) => number === 0 ? 2.4 * letter() : Math.max(3.5 * letter(), 18 + 0.6 * letter() * Math.max(...(words || [""]).map((word) => (word || "").length)));
  // Not more than eight decades: what lies below is rounding.
  const decades = (chart, low, high) => {
    if (!(high > 1e-30) || !Number.isFinite(high)) { return [0.1, 1]; }
    const top = Math.ceil(Math.log10(high));
    return [10 ** Math.min(top - 1, Math.floor(Math.log10(Math.max(low || 0, high * 1e-8)))), 10 ** top];
  };

  // uPlot's own loop for logarithmic axes does not end for some ranges, and lets powers of ten out by rounding.
  const logSplits = (chart, number, low, high) => {
    const found = [];
    if (!(low > 0) || !(high < Infinity) || !(high / low < 1e30)) { return [1]; }
    for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++) {
      for (let share = 1; share < 10; share++) {
        const value = Number(share + "e" + power);
        if (value >= low * (1 - 1e-9) && value <= high * (1 + 1e-9)) { found.push(value); }
      }
    }
    return found.length ? found : [low];
  };

  // Over more than three decades only powers of ten have lines.
  const powers = (chart, splits) => {
    const shown = splits.filter((v) => v > 0);
    if (shown.length < 2 || shown[shown.length - 1] / shown[0] < 1e3) { return splits; }
    return splits.map((v) => (v > 0 && Math.abs(Math.log10(v) - Math.round(Math.log10(v))) < 1e-6 ? v : null));
  };

  function axis(label, more) {
    const logarithmic = more && more.values === logTicks, filter = logarithmic ? { filter: powers } : {};
    return Object.assign({
      stroke: colour("muted"), grid: Object.assign({ stroke: colour("grid"), width: 1 }, filter), ticks: Object.assign({ stroke: colour("line"), width: 1 }, filter),
      label: label, labelSize: 2 * letter(), labelFont: 1.05 * letter() + "px system-ui", font: letter() + "px system-ui", size: axisSize, gap: 4,
    }, logarithmic ? { splits: logSplits } : {}, more || {});
  }

  function plot(id, make, data) {
    const element = get(id);
    const width = element.clientWidth, height = element.clientHeight;
    if (!width || !height) { return; }
    let known = plots[id];
    if (!known) {
      const options = make();
      options.width = width; options.height = height;
      options.cursor = Object.assign({ y: false, drag: { x: false, y: false } }, options.cursor || {});
      options.legend = { show: false };
      known = plots[id] = { chart: new uPlot(options, data, element), width, height };
    } else {
      if (known.width !== width || known.height !== height) {
        known.chart.setSize({ width, height });
        known.width = width; known.height = height;
      }
      known.chart.setData(data);
    }
  }

  function clearPlots() {
    for (const id in plots) { plots[id].chart.destroy(); delete plots[id]; }
    slow.changed = factsChanged = true;
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", clearPlots);

  const line = (label, number, more) => Object.assign({ label, stroke: colour(COLOURS[number % 8]), width: 1.5, dash: DASHES[number % 8], points: { show: false }, spanGaps: false }, more || {});
  const values = (array) => Array.from(array, (v) => (Number.isFinite(v) ? v : null));
  const SUPERSCRIPTS = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
  function number(v) {
    if (v === null || v === undefined) { return ""; }
    if (Math.abs(v) < 1e-30 || (Math.abs(v) < 1e4 && Math.abs(v) >= 1e-3)) { return String(Math.abs(v) < 1e-30 ? 0 : +v.toPrecision(5)).replace("-", "−"); }
    const exponent = Math.floor(Math.log10(Math.abs(v)) + 1e-9), share = +(v / 10 ** exponent).toPrecision(4);
    const power = "10" + Array.from(String(exponent), (c) => SUPERSCRIPTS[c]).join("");
    return share === 1 ? power : String(share).replace("-", "−") + "·" + power;
  }
  const ticks = (chart, splits) => splits.map(number);
  // On logarithmic axes only powers of ten are named; with 2 and 5 where there are fewer than three of them, or all ticks
  // where there is less than a decade.
  const logTicks = (chart, splits) => {
    const shown = splits.filter((v) => v !== null);
    const decades = Math.log10(shown[shown.length - 1] / shown[0]);
    const named = (v) => { const share = Math.round(v / 10 ** Math.floor(Math.log10(v) + 1e-6)); return decades < 1 || share === 1 || (decades < 3 && (share === 2 || share === 5)); };
    return splits.map((v) => (v === null ? null : named(v) ? number(v) : ""));
  };
  const padded = (low, high, least) => {
    if (low === null || high === null || !Number.isFinite(low)) { return [0, 1]; }
    const room = Math.max((high - low) * 0.08, Math.abs(high) * (least || 1e-4), 1e-12);
    return [low - room, high + room];
  };

  function backbone(id, label, measured, std, reference, least) {
    // One axis for both curves: every abscissa of reference and points once.
    const q = factArrays.point_q, real = Array.from(q).filter((v) => v > 0), qr = factArrays.reference_q || [];
    const rows = [];
    for (let k = 0; k < qr.length; k++) { rows.push([qr[k], reference[k], null, null]); }
    for (let k = 0; k < q.length; k++) { if (q[k] > 0) { rows.push([q[k], null, measured[k], std[k]]); } }
    rows.sort((a, b) => a[0] - b[0]);
    const low = real.length ? Math.min(...real) / 3 : 0, high = real.length ? Math.max(...real) * 3 : Infinity;
    const kept = rows.filter((row) => row[0] > 0 && (row[2] !== null || (row[0] >= low && row[0] <= high)));
    if (!kept.length && !plots[id]) { return; }
    const data = [0, 1, 2, 3].map((column) => kept.map((row) => row[column]));
    plot(id, () => ({
      scales: { x: { time: false, distr: 3 }, y: { range: (chart, a, b) => padded(a, b, least) } },
      axes: [axis("modal amplitude q / m√kg", { values: logTicks }), axis(label, { values: ticks })],
      series: [{}, line("model", 5, { width: 2, spanGaps: true }), line("measured", 0, { stroke: null, paths: () => null, points: { show: true, size: 8, stroke: colour("blue"), fill: colour("blue") } }), { show: false }],
      hooks: { draw: [errorBars] },
    }), data);
  }

  // A curve turns back over the frequency, so it is drawn here; the chart itself has the points in ascending order.
  function responseCurves() {
    const f = factArrays.curve_f || [], y = factArrays.curve_y || [];
    if (!f.length) { return; }
    const order = Array.from(f, (_, k) => k).sort((a, b) => f[a] - f[b]);
    plot("plot-curve", () => ({
      scales: { x: { time: false, range: (chart, a, b) => padded(a, b) }, y: { range: (chart, a, b) => [0, padded(0, b)[1]] } },
      axes: [axis("frequency / Hz", { values: ticks }), axis(facts.curve_axis, { values: ticks })],
      series: [{}, line("measured", 0, { stroke: null, paths: () => null })],
      hooks: { draw: [branches] },
    }), [order.map((k) => f[k]), order.map((k) => y[k])]);
  }

  function branches(chart) {
    const f = factArrays.curve_f || [], y = factArrays.curve_y, stable = factArrays.curve_stable, curve = factArrays.curve_number;
    const context = chart.ctx, ratio = devicePixelRatio, at = (k) => [chart.valToPos(f[k], "x", true), chart.valToPos(y[k], "y", true)];
    context.save();
    context.lineWidth = 1.5 * ratio;
    for (let k = 0; k < f.length; k++) {
      context.strokeStyle = context.fillStyle = colour(COLOURS[curve[k] % 8]);
      if (k && curve[k] === curve[k - 1]) {
        context.setLineDash(stable[k] === 0 || stable[k - 1] === 0 ? [6 * ratio, 4 * ratio] : []);
        context.beginPath();
        context.moveTo(...at(k - 1)); context.lineTo(...at(k));
        context.stroke();
      }
      context.setLineDash([]);
      context.beginPath();
      context.arc(...at(k), 3 * ratio, 0, 2 * Math.PI);
      if (stable[k] === 0) { context.stroke(); } else { context.fill(); }
    }
    context.restore();
  }

  function errorBars(chart) {
    const [x, , y, std] = chart.data, context = chart.ctx;
    context.save();
    context.strokeStyle = colour("blue");
    context.lineWidth = 1.5 * devicePixelRatio;
    for (let k = 0; k < x.length; k++) {
      if (y[k] === null || !Number.isFinite(std[k])) { continue; }
      const at = chart.valToPos(x[k], "x", true), cap = 4 * devicePixelRatio;
      const top = chart.valToPos(y[k] + std[k], "y", true), bottom = chart.valToPos(y[k] - std[k], "y", true);
      context.beginPath();
      context.moveTo(at, top); context.lineTo(at, bottom);
      context.moveTo(at - cap, top); context.lineTo(at + cap, top);
      context.moveTo(at - cap, bottom); context.lineTo(at + cap, bottom);
      context.stroke();
    }
    context.restore();
  }

  const shown = () => facts.channels.filter((channel) => channel.shown >= 0).sort((a, b) => a.shown - b.shown);

  function drawWaves() {
    const channels = shown();
    const waves = channels.map((channel) => liveArrays["wave" + channel.shown] || []);
    const length = Math.max(0, ...waves.map((wave) => wave.length));
    if (length < 2) { return; }
    // Each in its own scale, as on an oscilloscope.
    const x = Array.from({ length }, (_, k) => (live.wave_seconds * 1000 * k) / length);
    const rows = waves.map((wave) => {
      let top = 0;
      for (const v of wave) { top = Math.max(top, Math.abs(v)); }
      return top > 0 && wave.length === length ? Array.from(wave, (v) => v / top) : new Array(length).fill(wave.length === length ? 0 : null);
    });
    const id = "plot-waves";
    if (plots[id] && plots[id].chart.series.length !== rows.length + 1) { plots[id].chart.destroy(); delete plots[id]; }
    plot(id, () => ({
      scales: { x: { time: false }, y: { range: [-1.05, 1.05] } },
      axes: [axis("time / ms", { values: ticks }), axis("share of the peak", { values: ticks })],
      series: [{}, ...channels.map((channel, n) => line(channel.name, n))],
    }), [x, ...rows]);
    get("wave-length").textContent = live.periods ? "last " + live.periods + " periods, each in its own scale" : "last 0.1 s, each in its own scale";
  }

  // A cleared canvas in the units of the page; null where it is not shown.
  function blank(id) {
    const canvas = get(id), ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width) { return null; }
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio);
    }
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.font = 1.05 * letter() + "px system-ui";
    context.fillStyle = colour("muted");
    context.strokeStyle = colour("grid");
    return { context, width, height };
  }

  function drawNyquist() {
    const sheet = blank("nyquist");
    if (!sheet) { return; }
    const { context, width, height } = sheet, x = [], y = [];
    const level = slow.track_level ? slow.track_level[slow.track_level.length - 1] : -1;
    for (let k = 0; slow.track_level && k < slow.track_level.length; k++) {
      const size = slow.track_response[k] / slow.track_force[k], angle = slow.track_phase[k] * Math.PI / 180;
      if (slow.track_level[k] === level && slow.track_state[k] >= 2 && size > 0 && Number.isFinite(size * angle)) { x.push(size * Math.cos(angle)); y.push(size * Math.sin(angle)); }
    }
    let top = 0;
    for (let k = 0; k < x.length; k++) { top = Math.max(top, Math.abs(x[k]), Math.abs(y[k])); }
    if (!(top > 0)) { context.fillText("no periodic excitation", 6, height - 6); return; }
    // From the origin on the left: a mode's circle lies to the right of it.
    const scale = Math.min(width * 0.8, height * 0.8) / (1.1 * top), left = Math.max(width * 0.15, width / 2 - 0.5 * top * scale);
    context.beginPath();
    context.moveTo(0, height / 2); context.lineTo(width, height / 2);
    context.moveTo(left, 0); context.lineTo(left, height);
    context.stroke();
    context.fillText(number(+top.toPrecision(3)) + " " + perNewton(), 6, 1.2 * letter());
    context.strokeStyle = colour("blue");
    context.fillStyle = colour("blue");
    context.lineWidth = 1.2;
    context.beginPath();
    for (let k = 0; k < x.length; k++) { context[k ? "lineTo" : "moveTo"](left + x[k] * scale, height / 2 - y[k] * scale); }
    context.stroke();
    context.beginPath();
    context.arc(left + x[x.length - 1] * scale, height / 2 - y[y.length - 1] * scale, 4, 0, 7);
    context.fill();
  }

  function drawShape() {
    const sheet = blank("shape");
    if (!sheet) { return; }
    const { context, width, height } = sheet, shape = liveArrays.shape || [], points = liveArrays.shape_points || [];
    const shown = Array.from(shape, (v, k) => [points[k], v]).filter((row) => row[0] > 0).sort((a, b) => a[0] - b[0]);
    if (!shown.length) { context.fillText("no periodic excitation", 6, height - 6); return; }
    const first = shown[0][0], span = Math.max(1, shown[shown.length - 1][0] - first), middle = height / 2 - letter();
    const at = (row) => [width * (0.08 + 0.84 * (shown.length > 1 ? (row[0] - first) / span : 0.5)), middle - row[1] * height * 0.36];
    context.beginPath(); context.moveTo(0, middle); context.lineTo(width, middle); context.stroke();
    shown.forEach((row) => { const label = String(row[0]); context.fillText(label, at(row)[0] - context.measureText(label).width / 2, height - 6); });
    context.strokeStyle = colour("blue"); context.fillStyle = colour("blue"); context.lineWidth = 1.5;
    context.beginPath();
    shown.forEach((row, k) => { context[k ? "lineTo" : "moveTo"](...at(row)); });
    context.stroke();
    shown.forEach((row) => { context.beginPath(); context.arc(...at(row), 4, 0, 7); context.fill(); });
  }

  function drawOrbit() {
    const sheet = blank("orbit");
    if (!sheet) { return; }
    const { context, width, height } = sheet, over = get("orbit-over").value;
    const x = liveArrays["orbit_" + over], y = liveArrays.orbit_force;
    const unit = over === "velocity" ? "m/s" : facts.response_unit;
    context.fillText("force / N", 6, 1.2 * letter());
    const label = (over === "velocity" ? "velocity / " : "response / ") + unit;
    context.fillText(label, width - context.measureText(label).width - 6, height - 6);
    context.strokeStyle = colour("grid");
    context.beginPath();
    context.moveTo(0, height / 2); context.lineTo(width, height / 2);
    context.moveTo(width / 2, 0); context.lineTo(width / 2, height);
    context.stroke();
    if (!x || !y || x.length < 8) { context.fillText("no periodic excitation", 6, height - 6); return; }
    let right = 0, top = 0;
    for (let k = 0; k < x.length; k++) { right = Math.max(right, Math.abs(x[k])); top = Math.max(top, Math.abs(y[k])); }
    if (!(right > 0 && top > 0)) { return; }
    context.fillText("±" + number(+top.toPrecision(3)), 6, 2.6 * letter());
    const limit = "±" + number(+right.toPrecision(3));
    context.fillText(limit, width - context.measureText(limit).width - 6, height - 1.8 * letter());
    context.strokeStyle = colour("blue");
    context.lineWidth = 1.5;
    context.beginPath();
    for (let k = 0; k < x.length; k++) {
      const px = width / 2 + (x[k] / right) * width * 0.42, py = height / 2 - (y[k] / top) * height * 0.36;
      if (k) { context.lineTo(px, py); } else { context.moveTo(px, py); }
    }
    context.stroke();
  }

  function drawSpectrum() {
    const f = slow.spectrum_response_f || slow.spectrum_force_f;
    if (!f || f.length < 2) { return; }
    const rows = ["force", "response"].map((name) => (slow["spectrum_" + name] || []).length === f.length ? Array.from(slow["spectrum_" + name], (v) => (v > 1e-30 ? v : null)) : new Array(f.length).fill(null));
    const id = "plot-spectrum";
    plot(id, () => ({
      scales: { x: { time: false }, y: { distr: 3, range: decades }, z: { distr: 3, range: decades } },
      axes: [axis("frequency / Hz", { values: ticks }), axis("force / N", { values: logTicks, stroke: colour("orange") }), axis("response / " + facts.response_unit, { scale: "z", side: 1, grid: { show: false }, values: logTicks, stroke: colour("blue") })],
      series: [{}, line("force", 1, { scale: "y", dash: [] }), line("response", 0, { scale: "z" })],
      hooks: { draw: [harmonicMarks] },
    }), [Array.from(f), ...rows]);
  }

  function harmonicMarks(chart) {
    if (!slow.fundamental || !slow.harmonics_response) { return; }
    const context = chart.ctx, ratio = devicePixelRatio;
    context.save();
    context.fillStyle = colour("ink");
    context.font = 0.9 * letter() * ratio + "px system-ui";
    slow.harmonics_response.forEach((amplitude, k) => {
      if (!(amplitude > 0)) { return; }
      const x = chart.valToPos((k + 1) * slow.fundamental, "x", true), y = chart.valToPos(amplitude, "z", true);
      if (!Number.isFinite(x) || !Number.isFinite(y)) { return; }
      context.beginPath();
      context.arc(x, y, 3 * ratio, 0, 7);
      context.fill();
      context.fillText(String(k + 1), x + 4 * ratio, y - 4 * ratio);
    });
    context.restore();
  }

  function drawLoop() {
    const t = slow.track_time;
    if (!t || t.length < 2) { return; }
    plot("plot-loop", () => ({
      scales: { x: { time: false }, y: { range: (chart, a, b) => padded(a, b) }, z: { range: (chart, a, b) => { const top = Math.min(180, Math.max(2, Math.abs(a || 0), Math.abs(b || 0))); return [-top, top]; } } },
      axes: [axis("bench time / s", { values: ticks }), axis("excitation frequency / Hz", { values: ticks, stroke: colour("blue") }), axis("phase error / °", { scale: "z", side: 1, grid: { show: false }, values: ticks, stroke: colour("orange") })],
      series: [{}, line("frequency", 0), line("phase error", 1, { scale: "z", dash: [], width: 1 })],
    }), [Array.from(t), values(slow.track_frequency), values(slow.track_phase)]);
  }

  const perNewton = () => (facts.response_unit.includes("/") ? "(" + facts.response_unit + ")/N" : facts.response_unit + "/N");

  function drawKinds() {
    const test = facts.test, modal = facts.gives_points && !facts.is_curve;
    get("backbone-panel").hidden = get("damping-panel").hidden = !modal;
    get("frf-panel").hidden = get("coherence-panel").hidden = test !== "random";
    get("curve-panel").hidden = !facts.is_curve;
    get("swept-panel").hidden = test !== "sweep" && test !== "stepped_sine";
    get("decay-panel").hidden = test !== "ring_down";
    for (const id of ["orbit-panel", "loop-panel", "nyquist-panel", "shape-panel"]) { get(id).hidden = test === "random"; }
    if (test === "random" && slow.frf_f && slow.frf_f.length > 1) {
      get("averages").textContent = (slow.averages ? slow.averages[0] : 0) + " averages";
      const f = Array.from(slow.frf_f);
      plot("plot-frf", () => ({
        scales: { x: { time: false, distr: 3 }, y: { distr: 3, range: decades } },
        axes: [axis("frequency / Hz", { values: logTicks }), axis("|H₁| / " + perNewton(), { values: logTicks })],
        series: [{}, line("H1", 0)],
      }), [f, Array.from(slow.frf, (v) => (v > 1e-30 ? v : null))]);
      plot("plot-coherence", () => ({
        scales: { x: { time: false, distr: 3 }, y: { range: [0, 1.02] } },
        axes: [axis("frequency / Hz", { values: logTicks }), axis("coherence", { values: ticks })],
        series: [{}, line("coherence", 2, { dash: [] })],
      }), [f, values(slow.coherence)]);
    }
    const t = slow.track_time;
    if (!get("swept-panel").hidden && t && t.length > 1) {
      const rows = [];
      for (let k = 0; k < t.length; k++) {
        const f = slow.track_frequency[k], r = slow.track_response[k] / slow.track_force[k];
        if (f > 0 && r > 0 && Number.isFinite(r) && slow.track_state[k] >= 3) { rows.push([f, r]); }
      }
      rows.sort((a, b) => a[0] - b[0]);
      if (rows.length > 1) {
        plot("plot-swept", () => ({
          scales: { x: { time: false }, y: { distr: 3, range: decades } },
          axes: [axis("frequency / Hz", { values: ticks }), axis("response per force / " + perNewton(), { values: logTicks })],
          series: [{}, line("response per force", 0)],
        }), [rows.map((r) => r[0]), rows.map((r) => r[1])]);
      }
    }
    if (!get("decay-panel").hidden && t && t.length > 1) {
      plot("plot-decay", () => ({
        scales: { x: { time: false }, y: { distr: 3, range: decades } },
        axes: [axis("bench time / s", { values: ticks }), axis("response / " + facts.response_unit, { values: logTicks })],
        series: [{}, line("response", 0)],
      }), [Array.from(t), Array.from(slow.track_response, (v) => (v > 1e-30 ? v : null))]);
    }
  }

  function drawStrip() {
    const channels = shown();
    if (!strips || strips.newest < 1 || !channels.length) { return; }
    const chosen = Math.min(get("strip-channel").selectedIndex < 0 ? 0 : get("strip-channel").selectedIndex, channels.length - 1);
    const size = facts.strip_stretches, step = facts.strip_seconds;
    const x = [], low = [], high = [];
    for (let n = Math.max(0, strips.newest - size + 1); n <= strips.newest; n++) {
      x.push((n - strips.newest) * step);
      const a = strips.low[chosen][n % size], b = strips.high[chosen][n % size];
      low.push(Number.isFinite(a) ? a : null); high.push(Number.isFinite(b) ? b : null);
    }
    const channel = channels[chosen], id = "plot-strip";
    if (plots[id] && plots[id].name !== channel.name) { plots[id].chart.destroy(); delete plots[id]; }
    plot(id, () => ({
      scales: { x: { time: false, range: [-size * step, 0] }, y: { range: (chart, a, b) => padded(a, b) } },
      axes: [axis("time / s", { values: ticks }), axis(channel.name + " / " + channel.unit, { values: ticks })],
      series: [{}, line("largest", 0, { width: 1 }), line("smallest", 0, { width: 1 })],
      bands: [{ series: [1, 2], fill: colour("blue") + "66" }],
    }), [x, high, low]);
    if (plots[id]) { plots[id].name = channel.name; }
  }

  // -- words ---------------------------------------------------------------------------------------------------------

  function text(id, words) { const element = get(id); if (element.textContent !== words) { element.textContent = words; } }
  function make(tag, words, more) { const element = document.createElement(tag); element.textContent = words; Object.assign(element, more || {}); return element; }

  const PHASES = { idle: ["no run", ""], running: ["running", "busy"], paused: ["paused", "warn"], stopping: ["ramping to zero", "warn"], done: ["done", "good"], unknown: ["no run", ""] };
  const LOOPS = { locked: "good", acquiring: "busy", lock_lost: "bad", fixed: "", unknown: "" };

  function pill(id, words, kind) { const element = get(id); text(id, words); element.className = "pill " + kind; }

  function showNumbers() {
    if (live.phase !== shownPhase) { shownPhase = live.phase; controls(); }
    const [words, kind] = PHASES[live.phase] || PHASES.unknown;
    const failed = live.phase === "done" && facts && facts.result && facts.result !== "SUCCEEDED";
    const [verdict, tone] = live.phase === "done" && facts && facts.verdict || ["", ""];
    if (failed) { pill("phase", "ended: " + facts.result.toLowerCase().replace("_", " "), "bad"); }
    else { pill("phase", verdict ? words + ": " + verdict : words, { partly: "warn", bad: "bad" }[tone] || kind); }
    pill("loop", live.loop_text, LOOPS[live.loop] || "");
    text("level", live.level); text("frequency", live.frequency); text("phase-error", live.phase_error);
    text("force", live.force); text("response", live.response); text("left", live.left); text("bench-time", live.bench_time);
    const share = live.drive_share;
    const bar = get("drive-bar");
    bar.style.width = 100 * Math.min(1, share || 0) + "%";
    bar.className = share > 0.95 ? "bad" : share > 0.8 ? "warn" : "";
    text("drive", live.drive + (live.drive_limit !== "—" ? " of " + live.drive_limit : ""));
    const exciters = live.exciters || [], table = get("exciters");
    table.hidden = !exciters.length;
    exciters.forEach((row, k) => {
      const line_ = table.tBodies[0].rows[k] || table.tBodies[0].insertRow();
      [row.name, row.force, row.drive].forEach((words, n) => { const cell = line_.cells[n] || line_.insertCell(); if (cell.textContent !== words) { cell.textContent = words; } });
    });
    while (table.tBodies[0].rows.length > exciters.length) { table.tBodies[0].deleteRow(-1); }
    get("progress-bar").style.width = 100 * live.progress + "%";
    text("progress", (facts ? Math.max(0, live.level_index + 1) + " of " + facts.plan.length + ", " : "") + Math.round(100 * live.progress) + " %");
    text("gaps", live.gaps ? live.gaps + " gaps in what the page has seen; the recording is not concerned." : "");
    text("real-time", live.real_time ? live.real_time > 0 ? "Real-time margin " + Math.round(100 * live.real_time) + " %." : "No real-time margin is left." : "");
    const nodes = get("nodes"), key = JSON.stringify(live.nodes.map((node) => [node.name, node.level, node.level ? node.text : ""]));
    if (nodes.dataset.key !== key) {
      nodes.dataset.key = key;
      nodes.replaceChildren(...live.nodes.map((node) => make("span", node.name + (node.level > 1 ? ": " + node.text : node.level ? ": warning" : " ✓"), { className: "pill " + ["good", "warn", "bad"][node.level], title: node.text })));
    }
  }

  // What is wrong besides a stop of the drive, which has its own line: that one stays whatever else is wrong.
  function showAlarm() {
    const age = performance.now() - heardAt, sentences = [];
    if (heardAt && age > 1500) { sentences.push("No data for " + (age / 1000).toFixed(0) + " s: what is shown is old. The test may go on; the emergency stop has its own way."); }
    else if (!heardAt && performance.now() > 3000) { sentences.push("No connection to the page's server."); }
    if (facts && !facts.stopped && live && live.tripped) { sentences.push("The drive is held at zero: " + live.tripped + "."); }
    if (facts && facts.result && facts.result !== "SUCCEEDED") { sentences.push(facts.reason); }
    const lost = live ? live.nodes.filter((node) => node.level > 1).map((node) => node.name + ": " + node.text) : [];
    if (lost.length) { sentences.push("Nodes: " + lost.join("; ").replace(/\.$/, "") + "."); }
    if (live && live.warnings) { sentences.push("Warning: " + live.warnings + "."); }
    text("alarm", sentences.join(" "));
    get("alarm").hidden = !sentences.length;
    text("modes", facts ? facts.modes : "");
    get("modes").hidden = !(facts && facts.modes);
  }

  function showStop() {
    if (facts.stopped) { driveStop.held(facts.stopped); } else if (facts.stop_state === "released") { driveStop.released(); }
  }

  function showFacts() {
    showStop();
    document.title = (facts.rig || "Modal test") + (facts.run ? " · " + facts.run : "");
    text("rig", facts.rig || "Modal test");
    text("run", [facts.run, facts.test.replace("_", " ")].filter(Boolean).join(" · "));
    get("plan").replaceChildren(...facts.plan.map((row) => {
      const item = make("li", row.text + " " + facts.level_unit + (["waiting", "present", "done"].includes(row.state) ? "" : " " + row.state), { title: "Level " + (row.index + 1) + ": " + row.state + (row.why ? ". " + row.why : "") });
      item.dataset.state = row.state;
      if (row.state === "present") { item.setAttribute("aria-current", "step"); }
      return item;
    }));
    const points = get("points");
    points.tHead.replaceChildren(); points.tBodies[0].replaceChildren();
    if (facts.table.length) {
      const head = points.tHead.insertRow();
      for (const words of facts.table_head) { head.append(make("th", words, { scope: "col" })); }
      for (const row of facts.table) {
        const line_ = points.tBodies[0].insertRow();
        row.cells.forEach((cell, k) => { const box = make("td", cell); box.dataset.head = facts.table_head[k]; line_.append(box); });
        if (row.reason) { line_.append(make("td", row.reason, { className: "reason", colSpan: facts.table_head.length - 1 })); }
      }
    } else {
      const others = facts.plan.filter((row) => row.why);
      for (const row of others) { const line_ = points.tBodies[0].insertRow(); line_.append(make("td", row.text + " " + facts.level_unit), make("td", row.state + ": " + row.why, { className: "reason" })); }
      if (!others.length) { points.tBodies[0].insertRow().append(make("td", facts.gives_points ? "No modal point yet." : "This kind of test gives no modal points while it runs.")); }
    }
    get("acts").replaceChildren(...facts.acts.map((words) => make("li", words)));
    const key = JSON.stringify(facts.channels);
    const table = get("channels").tBodies[0];
    if (table.dataset.key !== key) {
      table.dataset.key = key;
      channelRows = facts.channels.map((channel) => {
        const row = make("tr", "");
        const cells = [make("td", channel.name + (channel.point ? ", point " + channel.point : "")), make("td", "—"), make("td", ""), make("td", "—"), make("td", "")];
        const bars = [channelBar(cells[2], channel.warning_peak, channel.abort_peak), channelBar(cells[4], channel.warning_rms, channel.abort_rms)];
        row.append(...cells);
        return { row, cells, bars, channel };
      });
      table.replaceChildren(...channelRows.map((item) => item.row));
      const channels = shown(), select = get("strip-channel"), chosen = select.selectedIndex;
      select.replaceChildren(...channels.map((channel) => make("option", channel.name + " / " + channel.unit)));
      select.selectedIndex = Math.max(0, Math.min(chosen, channels.length - 1));
      get("wave-key").replaceChildren(...channels.map((channel, n) => {
        const item = make("span", channel.name);
        item.style.setProperty("--colour", "var(--" + COLOURS[n % 8] + ")");
        item.style.setProperty("--dash", DASHES[n % 8].length ? (DASHES[n % 8][0] > 4 ? "dashed" : "dotted") : "solid");
        return item;
      }));
      if (plots["plot-waves"]) { plots["plot-waves"].chart.destroy(); delete plots["plot-waves"]; }
    }
    get("steer").hidden = role !== "steer";
    const begun = facts.plan.filter((row) => row.state !== "waiting"), repeated = get("repeat-level"), list = JSON.stringify(begun.map((row) => [row.index, row.text]));
    if (repeated.dataset.key !== list) {
      const chosen = repeated.value;
      repeated.dataset.key = list;
      repeated.replaceChildren(make("option", "the present level", { value: "" }), ...begun.reverse().map((row) => make("option", "level " + (row.index + 1) + ": " + row.text + " " + facts.level_unit, { value: String(row.index) })));
      repeated.value = begun.some((row) => String(row.index) === chosen) ? chosen : "";
    }
    controls();
    if (facts.is_curve) { responseCurves(); }
    if (!get("backbone-panel").hidden) {
      backbone("plot-frequency", "modal frequency / Hz", factArrays.point_f, factArrays.point_f_std, factArrays.reference_f, 2e-3);
      backbone("plot-damping", "modal damping ratio / %", factArrays.point_d, factArrays.point_d_std, factArrays.reference_d, 0.05);
    }
  }

  function channelBar(cell, warning, abort) {
    if (!abort && !warning) { cell.append(make("span", "no level", { className: "muted" })); return null; }
    const full = abort || warning / 0.8;
    const bar = make("span", "", { className: "bar" }), fill = document.createElement("i"), mark = document.createElement("b");
    bar.title = [warning ? "warning at " + number(+warning.toPrecision(3)) : "", abort ? "abort at " + number(+abort.toPrecision(3)) : ""].filter(Boolean).join(", ");
    if (warning) { mark.style.left = 100 * Math.min(1, warning / full) + "%"; bar.append(mark); }
    bar.prepend(fill);
    cell.append(bar);
    return { fill, warning: warning || Infinity, abort: abort || Infinity, full };
  }

  function showChannels() {
    const peak = liveArrays.peak || [], rms = liveArrays.rms || [], floor = liveArrays.floor || [];
    channelRows.forEach((item, n) => {
      [[peak[n], 1, item.bars[0]], [rms[n], 3, item.bars[1]]].forEach(([value, column, bar]) => {
        const low = value === 0 && floor[n] > 1e-30;
        const words = Number.isFinite(value) ? (low ? "below " : "") + number(+(low ? floor[n] : value).toPrecision(low ? 2 : 4)) + "\u202f" + item.channel.unit : "—";
        if (item.cells[column].textContent !== words) { item.cells[column].textContent = words; }
        if (!bar) { return; }
        bar.fill.style.width = 100 * Math.min(1, (value || 0) / bar.full) + "%";
        bar.fill.className = value > bar.abort ? "bad" : value > bar.warning ? "warn" : "";
      });
    });
  }

  // -- steering ------------------------------------------------------------------------------------------------------

  // What was refused stays until the next order; a person may look away.
  function say(words) { text("answer", words); clearTimeout(answerTimer); if (words.startsWith("Taken")) { answerTimer = setTimeout(() => text("answer", ""), 8000); } }

  function post(path, order) {
    return fetch(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(order) }).then(async (answer) => {
      const body = await answer.text();
      try { return JSON.parse(body); } catch (error) { return { taken: false, message: body || String(answer.status) }; }
    }).catch(() => ({ taken: false, message: "the server does not answer" }));
  }

  const refused = (answer) => "Not taken: " + answer.message.replace(/\.$/, "") + ".";

  // The phase that is shown: the newest, whichever kind of frame told it.
  function phase() { return live ? live.phase : facts ? facts.phase : ""; }
  function steerable() { return role === "steer" && ["running", "paused"].includes(phase()); }

  function controls() {
    for (const id of ["pause", "skip", "repeat", "repeat-level", "end", "levels"]) { get(id).disabled = !steerable(); }
    const startable = role === "steer" && ["idle", "done"].includes(phase());
    get("start").hidden = !startable; get("change").hidden = startable;
    get("change").lastElementChild.disabled = !steerable();
    get("pause").firstChild.textContent = phase() === "paused" ? "Resume " : "Pause ";
  }

  function steer(order) {
    if (!steerable()) { return; }
    post("/steer", order).then((answer) => say(answer.taken ? "Taken." : refused(answer)));
  }
  const named = (act) => steer({ act, level_index: Math.max(0, live ? live.level_index : 0) });
  const acts = {
    pause: () => steer({ act: phase() === "paused" ? "resume" : "pause" }),
    skip: () => named("skip_level"),
    repeat: () => { const level = get("repeat-level").value; if (level === "") { named("repeat_level"); } else { steer({ act: "repeat_level", level_index: +level }); } },
    end: () => steer({ act: "end" }),
  };
  for (const id in acts) { get(id).addEventListener("click", acts[id]); }
  get("change").addEventListener("submit", (event) => {
    event.preventDefault();
    const words = get("levels").value.trim();
    const levels = words ? words.split(/[,;\s]+/).filter(Boolean).map(Number) : [];
    if (levels.some((level) => !(level > 0 && Number.isFinite(level)))) { say("Write the levels to come as a list of positive numbers, such as 0.5, 0.7, 1; an empty field ends the plan after the present level."); return; }
    steer({ act: "change_levels", levels });
  });
  get("start").addEventListener("submit", (event) => {
    event.preventDefault();
    const order = {};
    for (const [name, value] of new FormData(event.target)) { if (value.trim()) { order[name] = value.trim(); } }
    if (order.levels) { order.levels = order.levels.replace(/[;\s]+/g, ",").replace(/,+/g, ","); }
    if (!order.levels) { say("Write the levels of the new run, such as 0.2:1:5 for five levels from 0.2 to 1, or 0.2, 0.5, 1."); return; }
    post("/start", order).then((answer) => say(answer.taken ? "Taken: " + answer.message + "." : refused(answer)));
  });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.repeat || /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName)) { return; }
    const key = event.key;
    if (role === "replay" && key === " " && event.target.tagName !== "BUTTON") { event.preventDefault(); get("play").click(); }
    else if (key === "p") { acts.pause(); } else if (key === "k") { acts.skip(); } else if (key === "r") { acts.repeat(); } else if (key === "E") { acts.end(); }
  });

  // -- replay --------------------------------------------------------------------------------------------------------

  let dragging = false, player = null;
  function showPlayer(state) {
    player = state;
    if (dragging) { return; }
    get("position").max = state.duration; get("position").value = state.position;
    text("position-text", state.position.toFixed(1) + " of " + state.duration.toFixed(1) + " s");
    text("play", state.playing ? "Pause" : "Play");
    get("speed").value = String(state.speed);
  }
  get("position").addEventListener("input", () => { dragging = true; text("position-text", (+get("position").value).toFixed(1) + " s"); });
  get("position").addEventListener("change", () => { dragging = false; post("/replay", { seek: +get("position").value }); });
  get("play").addEventListener("click", () => post("/replay", { playing: !(player && player.playing) }));
  get("speed").addEventListener("change", () => post("/replay", { speed: +get("speed").value }));

  // -- the clock -----------------------------------------------------------------------------------------------------

  get("orbit-over").addEventListener("change", drawOrbit);
  if (role === "replay") { get("player").hidden = false; get("steer").hidden = true; get("stop-form").hidden = true; }
  if (role === "watch") { get("steer").hidden = true; }

  // A picture that cannot be drawn takes neither the numbers nor the other pictures with it.
  function safely(drawing) { try { drawing(); } catch (error) { console.error(error); } }

  let frames = 0;
  function draw() {
    requestAnimationFrame(draw);
    if (!live || heardAt === drawn) { return; }
    drawn = heardAt;
    frames += 1;
    if (facts && factsChanged) { factsChanged = false; showFacts(); }
    showNumbers();
    if (!facts) { return; }
    if (frames % 2 === 0) { safely(drawWaves); if (!get("orbit-panel").hidden) { safely(drawOrbit); safely(drawShape); } }
    if (frames % 4 === 0) { showChannels(); safely(drawStrip); }
    if (slow.changed) { slow.changed = false; [drawSpectrum, drawLoop, drawKinds, drawNyquist].forEach(safely); }
    document.body.dataset.sample = String(live.sample);
  }
  setInterval(showAlarm, 300);
  let letters = letter();
  addEventListener("resize", () => { if (letter() !== letters) { letters = letter(); clearPlots(); } slow.changed = factsChanged = true; });
  connect();
  requestAnimationFrame(draw);
})();
