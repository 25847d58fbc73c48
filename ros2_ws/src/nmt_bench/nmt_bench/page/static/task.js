// Shows the progress of a command that computes. Frames: see nmt_bench/page/frames.py.
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
    const table = get("rows");
    table.tHead.replaceChildren(); table.tBodies[0].replaceChildren();
    if (task.rows.length) {
      const head = table.tHead.insertRow();
      task.heading.forEach((words) => head.append(make("th", words)));
      task.rows.forEach((row) => { const line = table.tBodies[0].insertRow(); row.forEach((cell) => line.append(make("td", cell))); });
    } else { table.tBodies[0].insertRow().append(make("td", "Nothing to rank yet.")); }
  }

  function showNumbers(live) {
    text("elapsed", live.elapsed); text("left", live.left); text("since", live.since);
    text("present", outcome || live.present);
    get("bar").style.width = (live.total ? 100 * live.done / live.total : 0) + "%";
    text("count", live.total ? live.done + " of " + live.total : "—");
  }

  setInterval(() => {
    const age = performance.now() - heardAt, alarm = get("alarm");
    const words = age > 3000 && !outcome ? "No data for " + (age / 1000).toFixed(0) + " s: the page has ended or hangs. The command may go on; the terminal shows it." : "";
    if (alarm.textContent !== words) { alarm.textContent = words; }
    alarm.hidden = !words;
  }, 500);
  connect();
})();
