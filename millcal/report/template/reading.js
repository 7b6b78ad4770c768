"use strict";
(function () {
  for (const button of document.querySelectorAll("button.copy")) {
    const text = button.parentElement.querySelector("textarea");
    button.hidden = false;
    button.addEventListener("click", () => {
      text.select();
      const done = () => { button.textContent = "Copied"; };
      if (navigator.clipboard) navigator.clipboard.writeText(text.value).then(done, () => {});
    });
  }
  for (const svg of document.querySelectorAll("svg[data-x]")) {
    const figure = svg.closest("figure");
    const output = figure.querySelector("output");
    const [left, top, width, height] = svg.dataset.box.split(" ").map(Number);
    const scale = "log" in svg.dataset ? Math.log : (value) => value;
    const [from, to] = svg.dataset.x.split(" ").map((end) => scale(Number(end)));
    output.textContent = "Point at the chart, or focus it and use the arrow keys, to read values.";
    let names, rows, at = 0;
    const cursor = document.createElementNS("http://www.w3.org/2000/svg", "path");
    cursor.setAttribute("class", "cursor");
    const load = () => {
      if (rows) return;
      const lines = figure.querySelector("textarea").value.trim().split("\n");
      names = lines[0].split(",").map((name) => /^(.*?)(?: \[(.*)\])?$/.exec(name).slice(1));
      rows = lines.slice(1).map((line) => line.split(",").map((cell) => (cell === "" ? NaN : Number(cell))));
      svg.append(cursor);
    };
    const show = (index) => {
      at = Math.max(0, Math.min(rows.length - 1, index));
      const row = rows[at];
      const x = left + ((scale(row[0]) - from) / (to - from)) * width;
      cursor.setAttribute("d", "M" + x.toFixed(1) + "," + top + "v" + height);
      output.textContent = row.map((value, k) => {
        const shown = Number.isFinite(value) ? String(Number(value.toPrecision(4))).replace("-", "\u2212") : "\u2013";
        return names[k][0] + "\u00a0" + shown + (names[k][1] ? "\u00a0" + names[k][1] : "");
      }).join("  \u00b7  ");
    };
    svg.addEventListener("pointermove", (event) => {
      load();
      const box = svg.getBoundingClientRect();
      const unit = svg.viewBox.baseVal.width / box.width;
      const x = from + (((event.clientX - box.left) * unit - left) / width) * (to - from);
      let best = 0;
      rows.forEach((row, k) => { if (Math.abs(scale(row[0]) - x) < Math.abs(scale(rows[best][0]) - x)) best = k; });
      show(best);
    });
    svg.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1, PageUp: 20, PageDown: -20, Home: -1e9, End: 1e9 }[event.key];
      if (!step) return;
      load();
      show(at + (event.shiftKey ? 10 * step : step));
      event.preventDefault();
    });
  }
})();
