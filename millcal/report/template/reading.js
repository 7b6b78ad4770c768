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
    const byPoint = svg.dataset.y ? svg.dataset.y.split(" ").map(Number) : null;
    const [from, to] = svg.dataset.x.split(" ").map((end) => scale(Number(end)));
    output.textContent = figure.closest(".set.thirds") ? "Point at it to read values."
      : "Point at the chart, or focus it and use the arrow keys, to read values.";
    let names, rows, at = 0;
    const cursor = document.createElementNS("http://www.w3.org/2000/svg", "path");
    cursor.setAttribute("class", "cursor");
    const load = () => {
      if (rows) return;
      const lines = figure.querySelector("textarea").value.trim().split("\n");
      names = lines[0].split(",").map((name) => /^(.*?)(?: \[(.*)\])?$/.exec(name).slice(1));
      rows = lines.slice(1).map((line) => line.split(",").map((cell) => (cell === "" ? NaN : isNaN(cell) ? cell : Number(cell))));
      svg.append(cursor);
    };
    const show = (index) => {
      at = Math.max(0, Math.min(rows.length - 1, index));
      const row = rows[at];
      const x = left + ((scale(row[0]) - from) / (to - from)) * width;
      if (byPoint) {
        const y = top + ((byPoint[1] - row[1]) / (byPoint[1] - byPoint[0])) * height;
        cursor.setAttribute("d", "M" + (x - 7).toFixed(1) + "," + y.toFixed(1) + "a7,7 0 1 0 14,0a7,7 0 1 0 -14,0");
      } else cursor.setAttribute("d", "M" + x.toFixed(1) + "," + top + "v" + height);
      output.textContent = row.map((value, k) => {
        const shown = typeof value === "string" ? value : Number.isFinite(value) ? String(Number(value.toPrecision(4))).replace("-", "\u2212") : "\u2013";
        return names[k][0] + "\u00a0" + shown + (names[k][1] ? "\u00a0" + names[k][1] : "");
      }).join("  \u00b7  ");
    };
    svg.addEventListener("pointermove", (event) => {
      load();
      const box = svg.getBoundingClientRect();
      const unit = svg.viewBox.baseVal.width / box.width;
      const x = ((event.clientX - box.left) * unit - left) / width;
      const y = ((event.clientY - box.top) * unit - top) / height;
      const away = (row) => {
        const across = (scale(row[0]) - from) / (to - from) - x;
        if (!byPoint) return Math.abs(across);
        return Math.hypot(across * width, ((byPoint[1] - row[1]) / (byPoint[1] - byPoint[0]) - y) * height);
      };
      let best = 0;
      rows.forEach((row, k) => { if (away(row) < away(rows[best])) best = k; });
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
