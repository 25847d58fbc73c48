// Shows the progress of an investigation. Frames: see nmt_bench/page/frames.py.
"use strict";
(function () {
  const get = (id) => document.getElementById(id);
  const decoder = new TextDecoder();
  let heardAt = 0, outcome = "";
  const text = (id, words) => { const element = get(id); if (element.textContent !== words) { element.textContent = words; } };
  const make = (tag, words) => { const element = document.createElement(tag); element.textContent = words; return element; };

  function connect() {
    const socket = new WebSocket("ws://" + location.host + "/live");
    socket.binaryType = "arraybuffer";
    socket.onmessage = (event) => {
      const length = new DataView(event.data).getUint32(4, true);
      const head = JSON.parse(decoder.decode(new Uint8Array(event.data, 8, length)));
      heardAt = performance.now();
      if (head.kind === "task") { showTask(head); } else if (head.kind === "live") { showNumbers(head); }
    };
    socket.onclose = () => setTimeout(connect, 1000);
  }

  function showTask(task) {
    document.title = task.title || "Progress";
    text("title", task.title || "Progress");
    outcome = task.outcome;
    text("phase", outcome ? "ended" : "at work");
    get("phase").className = "pill " + (outcome ? "good" : "busy");
    get("steps").replaceChildren(...task.steps.slice().reverse().map((step) => {
      const item = make("li", step.text);
      if (step.took) { item.append(make("span", step.took)); } else { item.setAttribute("aria-current", "step"); }
      return item;
    }));
    ask(task); draw(task.timeline);
    const table = get("rows");
    table.tHead.replaceChildren(); table.tBodies[0].replaceChildren();
    if (task.rows.length) {
      const head = table.tHead.insertRow();
      task.heading.forEach((words) => head.append(make("th", words)));
      task.rows.forEach((row) => { const line = table.tBodies[0].insertRow(); row.forEach((cell) => line.append(make("td", cell))); });
    } else { table.tBodies[0].insertRow().append(make("td", "Nothing to rank yet.")); }
  }

  function ask(task) {
    const steers = document.body.dataset.role === "steer";
    get("asked").hidden = Boolean(task.outcome) || !(task.question || steers);
    text("question", task.question || "Nothing is asked now.");
    document.querySelectorAll("#answers button").forEach((button) => {
      button.hidden = !steers;
      button.disabled = !task.question && button.dataset.answer !== "stop";
    });
  }

  async function answer(word) {
    const sent = await fetch("/answer", {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify({answer: word})});
    const words = sent.headers.get("Content-Type").startsWith("application/json") ? (await sent.json()).message : await sent.text();
    text("reply", words + ".");
  }

  function draw(lines) {
    const names = Object.keys(lines), svg = get("timeline"), space = "http://www.w3.org/2000/svg";
    get("believed").hidden = !names.length;
    const end = Math.max(1, ...names.flatMap((name) => lines[name].map((point) => point[0])));
    const at = (point) => (40 + 440 * point[0] / end).toFixed(1) + "," + (180 - 160 * point[1]).toFixed(1);
    const add = (tag, values, words) => {
      const element = document.createElementNS(space, tag);
      Object.entries(values).forEach(([key, value]) => element.setAttribute(key, value));
      if (words) { element.textContent = words; }
      svg.append(element);
    };
    svg.replaceChildren();
    add("path", {d: "M40,20 V180 H480", class: "axis", fill: "none", stroke: "currentColor"});
    add("text", {x: 4, y: 26}, "1"); add("text", {x: 4, y: 184}, "0"); add("text", {x: 440, y: 198}, end.toFixed(0) + " s");
    names.forEach((name, number) => {
      const dash = number ? String(2 + 3 * number) + " 3" : "none";
      add("polyline", {points: lines[name].map(at).join(" "), fill: "none", stroke: "currentColor", "stroke-dasharray": dash, "stroke-width": number ? 1 : 2});
      lines[name].forEach((point) => { const [cx, cy] = at(point).split(","); add("circle", {cx, cy, r: 3, fill: "currentColor"}); });
      const last = lines[name][lines[name].length - 1];
      if (last) { add("text", {x: 490, y: 30 + 18 * number}, name + " " + (100 * last[1]).toFixed(0) + " %"); }
    });
  }

  function showNumbers(live) {
    text("elapsed", live.elapsed); text("since", live.since);
    text("present", outcome || live.present);
  }

  setInterval(() => {
    const age = performance.now() - heardAt, alarm = get("alarm");
    const words = age > 3000 && !outcome ? "No data for " + (age / 1000).toFixed(0) + " s: the page has ended or hangs. The command may go on; the terminal shows it." : "";
    if (alarm.textContent !== words) { alarm.textContent = words; }
    alarm.hidden = !words;
  }, 500);
  document.querySelectorAll("#answers button").forEach((button) => button.addEventListener("click", () => answer(button.dataset.answer)));
  connect();
})();
