// Draws every picture of the page, once for wide and once for narrow windows, and sorts tables by a click on a heading.
(() => {
  const NARROW = 560, PAPER = 680;

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
  plots.forEach((box) => draw(box, box.clientWidth));
  addEventListener("resize", () =>
    plots.forEach((box) => {
      if (String(box.clientWidth < NARROW) !== box.dataset.narrow) draw(box, box.clientWidth);
    }),
  );
  addEventListener("beforeprint", () => plots.forEach((box) => Plotly.relayout(box, { width: Math.min(box.clientWidth, PAPER) })));
  addEventListener("afterprint", () => plots.forEach((box) => Plotly.relayout(box, { width: null, autosize: true })));

  const number = (text) => parseFloat(text.replace(/[\u202f\u2009≥≤ ]/g, "").replace("−", "-").replace("∞", "Infinity"));
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
