"use strict";
// Charts drawn as SVG from numbers. Lines differ in dashes and marks as well as colour, so that
// they are told apart in greyscale.
const charts = (() => {
  const SVG = "http://www.w3.org/2000/svg";
  const STYLES = [
    { colour: "var(--c0)", dash: "", mark: "circle", width: 2.6 },
    { colour: "var(--c1)", dash: "7 4", mark: "square", width: 2 },
    { colour: "var(--c2)", dash: "2 3", mark: "triangle", width: 2 },
    { colour: "var(--c3)", dash: "9 3 2 3", mark: "diamond", width: 2 },
    { colour: "var(--c4)", dash: "12 4", mark: "cross", width: 1.8 },
    { colour: "var(--c5)", dash: "4 2 1 2 1 2", mark: "circle", width: 1.8 },
  ];
  const MARGIN = { left: 52, right: 10, top: 8, bottom: 36 };

  function element(name, attributes, parent) {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (parent) parent.append(made);
    return made;
  }

  function ticks(low, high, count) {
    const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 2.5, 5, 10].find((s) => s * power >= rough) * power;
    const found = [];
    for (let x = Math.ceil(low / step - 1e-9) * step; x <= high + step * 1e-9; x += step) found.push(Math.abs(x) < step * 1e-9 ? 0 : x);
    return found;
  }

  function powers(low, high) {
    const found = [];
    for (let p = Math.floor(Math.log10(low)); p <= Math.ceil(Math.log10(high)); p++)
      for (const m of [1, 2, 5]) { const x = m * 10 ** p; if (x >= low * 0.999 && x <= high * 1.001) found.push(x); }
    return found;
  }

  const text = (x) => String(Number(x.toPrecision(6))).replace("-", "−");

  function range(series, axis, fixed) {
    let low = Infinity, high = -Infinity;
    for (const one of series) for (const v of one[axis]) if (v !== null) { if (v < low) low = v; if (v > high) high = v; }
    if (fixed) { low = fixed[0] ?? low; high = fixed[1] ?? high; }
    if (!Number.isFinite(low) || !Number.isFinite(high)) return [0, 1];
    if (low === high) { low -= 0.5; high += 0.5; }
    return [low, high];
  }

  function draw(svg, series, options) {
    const width = svg.clientWidth || 400, height = svg.clientHeight || 190;
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.setAttribute("role", "img");
    svg.setAttribute("aria-label", `${options.y} over ${options.x}: ${series.map((s) => s.name).join(", ")}`);
    svg.replaceChildren();
    let [x0, x1] = range(series, "x", options.xRange), [y0, y1] = range(series, "y", options.yRange);
    if (!options.yRange) { const pad = 0.06 * (y1 - y0); y0 -= pad; y1 += pad; }
    if (options.pad) { const pad = options.pad * (x1 - x0); x0 -= pad; x1 += pad; }
    const inner = { left: MARGIN.left, right: width - MARGIN.right, top: MARGIN.top, bottom: height - MARGIN.bottom };
    const log = options.log ? Math.log : (v) => v;
    const px = (x) => inner.left + (log(x) - log(x0)) / (log(x1) - log(x0)) * (inner.right - inner.left);
    const py = (y) => inner.bottom - (y - y0) / (y1 - y0) * (inner.bottom - inner.top);
    const across = Math.max(3, Math.floor(width / 80));
    let xs = options.log ? powers(x0, x1) : ticks(x0, x1, across);
    if (options.log && xs.length > across + 2) xs = xs.filter((x) => /^1/.test(x.toPrecision(1)) || x.toPrecision(1).startsWith("0.1") || /^0\.0*1$/.test(String(x)) || x === xs.at(-1));
    for (const x of xs) {
      element("line", { class: "grid", x1: px(x), x2: px(x), y1: inner.top, y2: inner.bottom }, svg);
      element("text", { x: px(x), y: inner.bottom + 14, "text-anchor": "middle" }, svg).textContent = text(x);
    }
    for (const y of ticks(y0, y1, 4)) {
      element("line", { class: "grid", x1: inner.left, x2: inner.right, y1: py(y), y2: py(y) }, svg);
      element("text", { x: inner.left - 6, y: py(y) + 4, "text-anchor": "end" }, svg).textContent = text(y);
    }
    element("rect", { class: "frame", x: inner.left, y: inner.top, width: inner.right - inner.left, height: inner.bottom - inner.top }, svg);
    element("text", { class: "title", x: (inner.left + inner.right) / 2, y: height - 5, "text-anchor": "middle" }, svg).textContent = options.x;
    const middle = (inner.top + inner.bottom) / 2;
    element("text", { class: "title", x: 12, y: middle, "text-anchor": "middle", transform: `rotate(-90 12 ${middle})` }, svg).textContent = options.y;
    const clip = `clip-${svg.id}`;
    const within = element("clipPath", { id: clip }, element("defs", {}, svg));
    element("rect", { x: inner.left - 1, y: inner.top - 1, width: inner.right - inner.left + 2, height: inner.bottom - inner.top + 2 }, within);
    for (const one of [...series].reverse()) {
      const style = STYLES[one.style % STYLES.length];
      const group = element("g", { class: one.old ? "old" : "", "data-name": one.name, "clip-path": `url(#${clip})` }, svg);
      let path = "", pen = "M";
      one.x.forEach((x, i) => {
        const y = one.y[i];
        if (y === null || x === null) { pen = "M"; return; }
        if (one.steps && pen === "L") path += `H${px(x).toFixed(1)}`;
        path += `${pen}${px(x).toFixed(1)} ${py(y).toFixed(1)}`;
        pen = "L";
      });
      element("path", { class: "curve", d: path, stroke: style.colour, "stroke-dasharray": style.dash, "stroke-width": style.width }, group);
      if (options.marks) one.x.forEach((x, i) => { if (one.y[i] !== null) mark(group, style, px(x), py(one.y[i])); });
    }
    return { x: (at) => x0 + (at - inner.left) / (inner.right - inner.left) * (x1 - x0), y: (at) => y0 + (inner.bottom - at) / (inner.bottom - inner.top) * (y1 - y0) };
  }

  function mark(group, style, x, y) {
    const shapes = {
      circle: `M${x - 4} ${y}a4 4 0 1 0 8 0a4 4 0 1 0 -8 0Z`,
      square: `M${x - 3.5} ${y - 3.5}h7v7h-7Z`,
      triangle: `M${x} ${y - 4.5}l4.5 8h-9Z`,
      diamond: `M${x} ${y - 5}l4.5 5l-4.5 5l-4.5 -5Z`,
      cross: `M${x - 4} ${y - 4}l8 8m0 -8l-8 8`,
    };
    element("path", { class: "mark", d: shapes[style.mark], stroke: style.colour }, group);
  }

  function sample(style) {
    const chosen = STYLES[style % STYLES.length];
    const svg = element("svg", { viewBox: "0 0 34 10" });
    element("line", { x1: 0, x2: 34, y1: 5, y2: 5, stroke: chosen.colour, "stroke-dasharray": chosen.dash, "stroke-width": chosen.width }, svg);
    return svg;
  }

  return { draw, sample };
})();
