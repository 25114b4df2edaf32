// Draws every picture of the page, once for wide and once for narrow windows, and sorts tables by a click on a heading.
(() => {
  const NARROW = 560, PAPER = 680;

  // No line is broken between a number and its unit: number_format.UNITS
  const UNITS = /(?<=[≥≤✗×]) (?=[\d−])|(?<=[\d∞]) (?=(?:×|%|°|dB|k?Hz|m?rad|m?s|m?m|kg|N·m[^\s,;)]*)(?![\w·/]))/g;
  for (const place of document.querySelectorAll("h1, h1 span, .note, .advice p, .advice summary, .warning"))
    for (const part of place.childNodes) if (part.nodeType === Node.TEXT_NODE) part.data = part.data.replace(UNITS, "\u00a0");

  const setPath = (target, path, value) => {
    const keys = path.split("."), last = keys.pop();
    for (const key of keys) target = target[key] ??= {};
    target[last] = value;
  };

  const draw = (box, width) => {
    const spec = JSON.parse(box.nextElementSibling.textContent);
    const narrow = width < NARROW;
    if (narrow) {
      spec.data = spec.data.filter((trace) => trace.meta !== "wide");
      spec.layout.annotations = (spec.layout.annotations ?? []).filter((note) => note.name !== "wide");
      for (const [path, value] of Object.entries(spec.narrow)) setPath(spec.layout, path, value);
    }
    else spec.layout.annotations = (spec.layout.annotations ?? []).filter((note) => note.name !== "narrow");
    box.dataset.narrow = narrow;
    Plotly.react(box, spec.data, spec.layout, { responsive: true, displaylogo: false, displayModeBar: false });
  };

  const plots = [...document.querySelectorAll(".plot")];
  const drawShown = () => plots.forEach((box) => box.dataset.narrow === undefined && box.clientWidth && draw(box, box.clientWidth));
  drawShown();
  document.querySelectorAll("details").forEach((part) => part.addEventListener("toggle", drawShown));
  addEventListener("resize", () =>
    plots.forEach((box) => {
      if (box.dataset.narrow !== undefined && box.clientWidth && String(box.clientWidth < NARROW) !== box.dataset.narrow) draw(box, box.clientWidth);
    }),
  );
  const drawn = () => plots.filter((box) => box.dataset.narrow !== undefined);
  addEventListener("beforeprint", () => drawn().forEach((box) => Plotly.relayout(box, { width: Math.min(box.clientWidth, PAPER) })));
  addEventListener("afterprint", () => drawn().forEach((box) => Plotly.relayout(box, { width: null, autosize: true })));

  for (const box of document.querySelectorAll(".pairs")) {
    const { titles, middles, maps } = JSON.parse(box.querySelector("script.maps").textContent);
    const [across, up] = box.querySelectorAll("select"), plot = box.querySelector(".plot"), held = plot.nextElementSibling;
    const show = () => {
      const x = Number(across.value), y = Number(up.value);
      const map = x < y ? maps[`${x},${y}`] : maps[`${y},${x}`];
      if (!map) return;
      const spec = JSON.parse(held.textContent);
      const z = x < y ? map[0].map((_, k) => map.map((row) => row[k])) : map;
      Object.assign(spec.data[0], { x: middles[x], y: middles[y], z });
      spec.layout.xaxis.title.text = titles[x];
      spec.layout.yaxis.title.text = titles[y];
      held.textContent = JSON.stringify(spec);
      draw(plot, plot.clientWidth);
    };
    across.addEventListener("change", show);
    up.addEventListener("change", show);
  }

  for (const button of document.querySelectorAll(".copied button"))
    button.addEventListener("click", () =>
      navigator.clipboard?.writeText(button.previousElementSibling.textContent).then(() => (button.textContent = "Copied")),
    );

  const number = (text) => parseFloat(text.replace(/[\u202f\u2009≥≤✗ ]/g, "").replace("−", "-").replace("∞", "Infinity"));
  for (const head of document.querySelectorAll("table.sorts th"))
    head.addEventListener("click", () => {
      const body = head.closest("table").tBodies[0], column = head.cellIndex;
      const up = (head.dataset.up = head.dataset.up === "true" ? "false" : "true") === "true";
      const value = (row) => row.cells[column].textContent;
      const order = (a, b) => {
        const difference = number(value(a)) - number(value(b));
        return (Number.isNaN(difference) ? value(a).localeCompare(value(b)) : difference) * (up ? 1 : -1);
      };
      [...body.rows].sort(order).forEach((row) => body.append(row));
    });
})();
