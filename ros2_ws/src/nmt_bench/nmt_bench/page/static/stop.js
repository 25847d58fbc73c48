// The emergency stop, by itself: works whatever becomes of the rest of the page. Without scripts the form does the same.
// What it says stays until the bench says that the drive is released.
"use strict";
(function () {
  var form = document.getElementById("stop-form");
  var alarm = document.getElementById("stop-alarm");
  var asked = 0, way = "", confirmed = "";
  function show() {
    var words = "";
    if (confirmed) {
      words = confirmed;
    } else if (asked) {
      var waited = (performance.now() - asked) / 1000;
      words = "Emergency stop requested";
      if (way === "failed") { words += ", but it did not reach the bench. Use the switch at the amplifier."; }
      else if (waited > 2) { words += " " + waited.toFixed(0) + " s ago; the bench has not confirmed it. Use the switch at the amplifier."; }
      else { words += way ? ". The drive goes to zero." : " …"; }
    }
    if (alarm.textContent !== words) { alarm.textContent = words; }
    alarm.hidden = !words;
  }
  function stop() {
    if (document.body.dataset.role === "replay") { return; }
    asked = performance.now(); way = "";
    show();
    var failed = 0;
    [form.action, "/stop"].forEach(function (address) {
      fetch(address, { method: "POST", keepalive: true }).then(function (answer) {
        if (!answer.ok) { throw new Error(String(answer.status)); }
        way = "reached"; show();
      }).catch(function () {
        failed += 1;
        if (failed === 2) { way = "failed"; show(); }
      });
    });
  }
  // Told by the rest of the page what the bench says: a sentence while the drive is held, and when it was released.
  window.driveStop = {
    held: function (sentence) { confirmed = sentence; show(); },
    released: function () { confirmed = ""; asked = 0; show(); }
  };
  form.addEventListener("submit", function (event) { event.preventDefault(); stop(); });
  document.addEventListener("keydown", function (event) {
    if (event.key === "Escape" && !event.repeat) { event.preventDefault(); stop(); }
  }, true);
  setInterval(show, 500);
})();
