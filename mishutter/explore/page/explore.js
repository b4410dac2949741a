"use strict";
// The page: fields made from the schema that the server sends, requests for designs, what comes back.
const $ = (id) => document.getElementById(id);
const MOST_UNDO = 100, MOST_LATENCIES = 5000, MOST_UPLOAD = 32 * 1024 * 1024;
const SENT = 5, OPTIMISED = "optimised", DRAWN = "drawn", STORED = "mishutter-tab";

const state = { scene: null, drawn: null, rows: [OPTIMISED, "best snapshot"], speed: null };
let fields = [], photographs = [], most = { chips: 64, pins: 6, rows: 4 }, pins = [];
let key = recalled()?.key ?? "", socket = null, retry = 500, number = 0, asking = false, committed = "", undo = [];
let changes = [], curves = {}, comparison = null, hasTable = false, isFinished = false, styles = { [OPTIMISED]: 0, [DRAWN]: 1, "best snapshot": 2 };
let drawing = false, stroke = null, profileScale = null, shots = [], lens = null, ticking = null;

// For scripts that drive the page: how long answers took, and what has come.
window.mishutter = { latencies: [], answers: { first: 0, finished: 0, table: 0, photograph: 0, plane: 0 }, latest: {}, state };

// ---------- connection

function connect() {
  const address = new URL(`/tab?key=${encodeURIComponent(key)}`, location.href);
  address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  socket = new WebSocket(address);
  socket.addEventListener("open", () => { retry = 500; });
  socket.addEventListener("message", (event) => receive(JSON.parse(event.data)));
  socket.addEventListener("close", () => {
    say("not connected: is mishutter explore still running?");
    setTimeout(connect, retry);
    retry = Math.min(retry * 2, 8000);
  });
}

function send(message) {
  if (socket.readyState === WebSocket.OPEN) socket.send(typeof message === "string" ? message : JSON.stringify(message));
}

function receive(message) {
  const kinds = { hello, doing, first, finished, table, photograph, plane, error, uploaded, recipe, closed: (m) => say(m.text), pin: tell, unpin: tell, load_design: tell, load_scene: loaded, save_scene: saved("scene.toml"), save_design: saved("design.json") };
  window.mishutter.latest[message.kind] = message;
  kinds[message.kind]?.(message);
}

function hello(message) {
  fields = message.fields; photographs = message.photographs; most = message.most;
  key = message.key; pins = message.pins;
  const kept = recalled(), gone = (kept?.pins ?? []).filter((name) => !pins.includes(name));
  state.scene = kept?.scene ?? message.scene;
  state.drawn = kept?.drawn ?? null;
  state.rows = (kept?.rows ?? [OPTIMISED, "best snapshot"]).filter((name) => !gone.includes(name));
  state.speed = kept?.speed ?? message.speed;
  $("speed").value = state.speed;
  undo = kept?.undo ?? [];
  lose([...gone, ...withoutPhotograph()]);
  committed = snapshot();
  showFields(); showPins(); remember();
  $("undo").disabled = undo.length === 0;
  doing({ text: message.doing });
  $("clear").disabled = state.drawn === null;
  ask();
}

function recalled() {
  try { return JSON.parse(sessionStorage.getItem(STORED)); } catch { return null; }
}

// A photograph that the server has no longer gives way to its first; its name, if that is so.
function withoutPhotograph() {
  const path = state.scene.picture?.path;
  if (!path || photographs.includes(path)) return [];
  state.scene.picture = { path: photographs[0] };
  return [path];
}

function lose(names) {
  $("lost").hidden = !names.length;
  $("lost").textContent = `No longer on the server: ${names.join(", ")}; load them again if you need them.`;
}

const snapshot = () => JSON.stringify({ scene: state.scene, drawn: state.drawn });

function commit() {
  const now = snapshot();
  if (now !== committed) {
    lose([]);
    undo.push(committed);
    if (undo.length > MOST_UNDO) undo.shift();
    committed = now;
  }
  $("undo").disabled = undo.length === 0;
  remember();
}

// A store that is full forgets what could be taken back, and then everything.
function remember() {
  const kept = { key, pins, ...state };
  for (const text of [{ ...kept, undo }, kept].map((all) => JSON.stringify(all))) {
    try { sessionStorage.setItem(STORED, text); return; } catch { sessionStorage.removeItem(STORED); }
  }
}

function takeBack() {
  if (!undo.length) return;
  committed = undo.pop();
  Object.assign(state, JSON.parse(committed));
  lose(withoutPhotograph());
  $("undo").disabled = undo.length === 0;
  $("clear").disabled = state.drawn === null;
  showFields(); remember(); ask();
}

// At most one request a frame; the server answers the latest.
function ask() {
  changes.push({ id: number + 1, at: performance.now() });
  if (changes.length > 500) changes.shift();
  if (asking) return;
  asking = true;
  requestAnimationFrame(() => {
    asking = false;
    number += 1;
    send({ kind: "design", id: number, scene: state.scene, drawn: state.drawn, rows: state.rows, speed: state.speed });
  });
}

// ---------- answers

function doing(message) { if (message.text) working(message.text); else say(""); }
function say(text) { clearInterval(ticking); $("state").textContent = text; }

// What goes on, and for how long: a search through a shutter that lags takes a while.
function working(text) {
  const since = performance.now();
  say(text);
  ticking = setInterval(() => { $("state").textContent = `${text}, ${((performance.now() - since) / 1000).toFixed(0)} s`; }, 1000);
}

function tell(message) { if (message.pins) { pins = message.pins; showPins(); remember(); ask(); } }
function count(kind) { window.mishutter.answers[kind] += 1; }

function problem(text) {
  $("problem").hidden = !text;
  $("problem").textContent = text ?? "";
}

function error(message) {
  if (message.id !== undefined && message.id !== number) return;
  if (message.id !== undefined) settle(message.id);
  problem(message.text);
  if (message.id !== undefined) say("the last design that could be found is shown");
}

function settle(id) {
  const now = performance.now();
  let latest = null;
  changes = changes.filter((change) => {
    if (change.id > id) return true;
    latest = now - change.at;
    window.mishutter.latencies.push(latest);
    return false;
  });
  if (window.mishutter.latencies.length > MOST_LATENCIES) window.mishutter.latencies.splice(0, 1000);
  return latest;
}

// Things that move in any direction: an answer and a picture, in place of curves and rows.
function plane(message) {
  problem(null); inPlane(true);
  isFinished = Boolean(message.picture);
  buttons();
  $("pin").disabled = true;
  $("verdict").textContent = message.verdict;
  $("answer").textContent = message.answer ?? "";
  if (message.picture) $("plane-picture").src = `data:image/png;base64,${message.picture}`;
  fade($("plane"), !message.picture);
  settle(message.id);
  say("");
  count("plane");
}

function inPlane(is) {
  $("plane").hidden = !is;
  for (const id of ["charts", "legend", "photographs"]) $(id).hidden = is;
  if (is) { hasTable = false; curves = {}; for (const part of ["thead", "tbody"]) document.querySelector(part).replaceChildren(); $("ceiling").textContent = ""; $("notes").replaceChildren(); }
}

function first(message) {
  problem(null); inPlane(false);
  take(message.curves, true);
  isFinished = false;
  for (const part of [document.querySelector("tbody"), $("panels")]) fade(part, true);
  buttons();
  const level = message.curves[OPTIMISED].numbers.psnr;
  $("verdict").textContent = `optimised: ${decibel(level)}, the search goes on when the hand rests`;
  drawCharts();
  const after = settle(message.id);
  if (after !== null) say(`first answer in ${after.toFixed(0)} ms`);
  count("first");
}

function finished(message) {
  take(message.curves, true);
  isFinished = true;
  const level = message.curves[OPTIMISED].numbers.psnr;
  $("verdict").textContent = `optimised: ${decibel(level)}; comparing`;
  $("verdict").title = message.outcome;
  working("comparing");
  buttons(); drawCharts();
  count("finished");
}

function table(message) {
  comparison = message; hasTable = true;
  for (const name of Object.keys(curves)) if (!state.rows.includes(name) && name !== OPTIMISED) delete curves[name];
  take(message.curves, false);
  pins = message.pins; showPins();
  fade(document.querySelector("tbody"), false);
  $("verdict").textContent = message.verdict;
  if (message.pictured) working("restoring the photograph"); else say("");
  showTable(); drawCharts();
  count("table");
}

function take(found, areOthersOld) {
  if (areOthersOld) for (const name of Object.keys(curves)) if (!(name in found)) curves[name].old = true;
  for (const [name, curve] of Object.entries(found)) curves[name] = curve;
  if (!state.drawn) delete curves[DRAWN];
}

function fade(part, isOld) { part.className = isOld ? "old" : ""; }

function buttons() {
  $("pin").disabled = !isFinished || pins.length >= most.pins;
  $("save-design").disabled = !isFinished;
}

const decibel = (x) => (x === null ? "∞ dB" : `${x.toFixed(2).replace("-", "−")} dB`);
const rounded = (x, digits) => (x === null ? "∞" : x.toFixed(digits).replace("-", "−").replace(/^−(0\.?0*)$/, "$1"));

function styleOf(name) {
  if (!(name in styles)) {
    const used = new Set(state.rows.filter((n) => n in styles).map((n) => styles[n]));
    styles[name] = [3, 4, 5, 2, 1].find((s) => !used.has(s)) ?? 3;
  }
  return styles[name];
}

// ---------- charts

function drawCharts() {
  const names = [OPTIMISED, ...Object.keys(curves).filter((n) => n !== OPTIMISED && (state.rows.includes(n) || n === DRAWN))].filter((n) => curves[n]);
  if (!names.length) return;
  const line = (x, y) => names.map((name) => ({ name, x: curves[name][x], y: curves[name][y], style: styleOf(name), old: curves[name].old }));
  const profiles = names.filter((n) => n !== DRAWN || !state.drawn).map((name) => {
    const c = curves[name];
    return { name, x: [c.time[0], ...c.time, c.time.at(-1)], y: [0, ...c.profile, 0], style: styleOf(name), old: c.old };
  });
  if (state.drawn) profiles.push(drawnSeries());
  profileScale = charts.draw($("profile"), profiles, { x: "time from mid-exposure / ms", y: "transmittance", yRange: [-0.03, 1.05] });
  const motions = line("path_time", "path"), best = curves[OPTIMISED];
  $("sent-to-stage").replaceChildren();
  if (best.sent) {
    const sent = { name: "sent to the stage", x: best.path_time, y: best.sent, style: SENT, old: best.old };
    motions.push(sent);
    $("sent-to-stage").append(", ", sampleOf(sent));
  }
  charts.draw($("motion"), motions, { x: "time from mid-exposure / ms", y: "position / px" });
  charts.draw($("signal"), line("frequency", "signal"), { x: "spatial frequency / (cycles/px)", y: "signal-to-noise ratio / dB", log: true, yRange: [-30, null] });
  charts.draw($("psnr"), line("speeds", "psnr"), { x: "object speed / (px/s)", y: "PSNR / dB", marks: true, pad: 0.03 });
  for (const id of ["signal-of", "psnr-of"]) $(id).textContent = `, ${best.of_decoder}`;
  drawKernels();
  $("legend").replaceChildren(...names.map((name) => {
    const item = document.createElement("span");
    const level = curves[name].numbers.psnr;
    item.append(charts.sample(styleOf(name)), `${name}: ${decibel(level)}${curves[name].old ? ", of an earlier scene" : ""}`);
    return item;
  }));
  const cost = state.drawn && curves[DRAWN] ? curves[OPTIMISED].numbers.psnr - curves[DRAWN].numbers.psnr : null;
  $("cost").hidden = cost === null;
  if (cost !== null) $("cost").textContent = `Your profile: ${decibel(curves[DRAWN].numbers.psnr)}, ${Math.abs(cost).toFixed(2)} dB ${cost >= 0 ? "below" : "above"} the optimised one on the same motion.`;
}

function drawnSeries() {
  const half = curves[OPTIMISED].time.at(-1), n = state.drawn.length, x = [-half], y = [0];
  state.drawn.forEach((w, i) => { x.push(-half + (2 * half * i) / n, -half + (2 * half * (i + 1)) / n); y.push(w, w); });
  x.push(half); y.push(0);
  return { name: DRAWN, x, y, style: styleOf(DRAWN) };
}

function drawKernels() {
  const name = state.drawn && curves[DRAWN] ? DRAWN : OPTIMISED, c = curves[name];
  const series = c.kernels.map((taps, index) => ({
    name: `${c.kernel_speeds[index]} px/s`, steps: true, style: index,
    x: [c.offset, ...taps.map((_, i) => c.offset + i), c.offset + taps.length], y: [0, ...taps, 0],
  }));
  charts.draw($("kernels"), series, { x: "position from the point of alignment / px", y: "light per px" });
  $("kernels-of").replaceChildren(`${name}: `, ...series.map(sampleOf));
}

function sampleOf(series) {
  const part = document.createElement("span"), sample = charts.sample(series.style);
  sample.setAttribute("width", 34); sample.setAttribute("height", 10);
  part.append(sample, ` ${series.name}  `);
  return part;
}

// ---------- drawing a profile

function chipAt(event) {
  const box = $("profile").getBoundingClientRect(), half = curves[OPTIMISED].time.at(-1);
  const time = profileScale.x(event.clientX - box.left), w = profileScale.y(event.clientY - box.top);
  const index = Math.floor(((time + half) / (2 * half)) * most.chips);
  return { index: Math.max(0, Math.min(most.chips - 1, index)), w: Math.max(0, Math.min(1, Math.round(w * 200) / 200)) };
}

function strokeTo(event) {
  const to = chipAt(event), from = stroke ?? to;
  const steps = Math.max(1, Math.abs(to.index - from.index));
  for (let k = 0; k <= steps; k++) {
    const index = Math.round(from.index + ((to.index - from.index) * k) / steps);
    state.drawn[index] = from.w + ((to.w - from.w) * k) / steps;
  }
  stroke = to;
  drawCharts(); ask();
}

function beginStroke(event) {
  if (!drawing || !curves[OPTIMISED]) return;
  event.preventDefault();
  $("profile").setPointerCapture(event.pointerId);
  if (!state.drawn) {
    const c = curves[OPTIMISED];
    state.drawn = Array.from({ length: most.chips }, (_, i) => Math.max(0, Math.min(1, c.profile[Math.round(((i + 0.5) / most.chips) * (c.profile.length - 1))])));
    if (!state.rows.includes(DRAWN) && state.rows.length < most.rows) state.rows.push(DRAWN);
  }
  stroke = null;
  strokeTo(event);
}

function endStroke() {
  if (!stroke) return;
  stroke = null;
  $("clear").disabled = false;
  commit();
}

// ---------- fields

const inside = (place) => place.reduce((table, key) => table?.[key], state.scene);

function put(place, value) {
  const key = place.at(-1);
  let table = state.scene;
  for (const part of place.slice(0, -1)) table = table[part] ??= {};
  if (value === undefined) delete table[key]; else table[key] = value;
}

function showFields() {
  $("fields").replaceChildren(...fields.map((section) => tableField(section, [section.key])));
}

function tableField(table, place) {
  const set = document.createElement("fieldset"), legend = document.createElement("legend");
  set.dataset.place = place.join(".");
  legend.title = table.description;
  const present = inside(place) !== undefined || !table.optional;
  if (table.optional) legend.append(checkbox(table.label, present, (on) => {
    put(place, on ? structuredClone(table.begin) : undefined);
    showFields(); commit(); ask();
  })); else legend.textContent = table.label;
  set.append(legend);
  if (present) for (const field of table.fields) set.append(field.kind === "table" ? tableField(field, [...place, field.key]) : oneField(field, [...place, field.key]));
  return set;
}

function checkbox(text, on, changed) {
  const label = document.createElement("label"), box = document.createElement("input");
  box.type = "checkbox"; box.checked = on;
  box.addEventListener("change", () => changed(box.checked));
  label.append(box, ` ${text}`);
  return label;
}

function oneField(field, place) {
  const row = document.createElement("div");
  row.className = "field";
  row.dataset.place = place.join(".");
  const present = inside(place) !== undefined, value = present ? inside(place) : field.default;
  if (field.optional) {
    row.append(checkbox(present || !field.unit ? field.label : `${field.label}, ${field.unit}`, present, (on) => { put(place, on ? structuredClone(field.begin) : undefined); showFields(); commit(); ask(); }));
    if (!present) { row.classList.add("off"); return row; }
  }
  const id = `f-${place.join("-")}`;
  if (!field.optional) {
    const label = document.createElement("label");
    label.htmlFor = id; label.textContent = field.label;
    row.append(label);
  }
  const control = { number: numberControls, integer: numberControls, list: listControl, boolean: truthControl, choice: choiceControl, text: textControl }[field.kind] ?? textControl;
  control(row, field, place, value, id);
  return row;
}

function unitOf(field) {
  const unit = document.createElement("span");
  unit.className = "unit"; unit.textContent = field.unit;
  return unit;
}

function numberControls(row, field, place, value, id) {
  const box = document.createElement("input");
  Object.assign(box, { type: "number", id, step: field.kind === "integer" ? 1 : "any", value });
  box.setAttribute("aria-label", `${place.join(" ")}${field.unit ? `, ${field.unit}` : ""}`);
  const range = `${field.minimum ?? "−∞"} to ${field.maximum ?? "∞"} ${field.unit}`;
  box.title = range;
  row.append(box, unitOf(field));
  const isWhole = field.kind === "integer";
  const slider = document.createElement("input");
  Object.assign(slider, { type: "range", min: 0, max: 1000, step: 1, title: range });
  slider.setAttribute("aria-label", place.join(" "));
  let scale = scaleOf(field, value);
  slider.value = scale.place(value);
  slider.addEventListener("input", () => {
    const to = scale.value(Number(slider.value));
    box.value = to; put(place, to);
    if (!isWhole) ask();
  });
  // Whole numbers set the sizes of programs, which are not compiled for numbers that are passed by.
  slider.addEventListener("change", () => { commit(); if (isWhole) ask(); });
  row.append(slider);
  box.addEventListener("input", () => {
    const to = Number(box.value);
    if (box.value === "" || !Number.isFinite(to) || (isWhole && !Number.isInteger(to))) { problem(`[${place[0]}] ${place.slice(1).join(".")} must be a ${isWhole ? "whole " : ""}number; got ${box.value || "nothing"}.`); return; }
    put(place, to);
    scale = scaleOf(field, to, scale); slider.value = scale.place(to);
    ask();
  });
  box.addEventListener("change", commit);
}

const tidy = (x) => Number(x.toPrecision(3));
const whole = (x) => Math.round(tidy(x));

// How a slider runs: evenly where the range is narrow, by ratios where a number is above 0, and
// from 0 on ever faster where it may be 0.
function scaleOf(field, value, before) {
  const low = field.minimum ?? -Infinity, high = field.maximum ?? Infinity;
  if (before && before.holds(value)) return before;
  const rounded = field.kind === "integer" ? whole : tidy;
  const made = (from, to, forward, back) => ({
    holds: (v) => v >= from && v <= to,
    place: (v) => Math.round(1000 * forward(Math.max(from, Math.min(to, v)))),
    value: (p) => Math.max(field.above ? Number.MIN_VALUE : low, Math.min(high, rounded(back(p / 1000)))),
  });
  if (high - low <= 1) {
    const from = field.above ? low + 0.01 * (high - low) : low, to = field.below ? high - 0.01 * (high - low) : high;
    return made(from, to, (v) => (v - from) / (to - from), (t) => from + t * (to - from));
  }
  if ((field.above || low > 0) && value > 0) {
    const from = Math.max(low, value / 10), to = Math.min(high, value * 10);
    return made(from, to, (v) => Math.log(v / from) / Math.log(to / from), (t) => from * (to / from) ** t);
  }
  if (low >= 0) {
    const to = Math.min(high, value > 0 ? value * 4 : 100);
    return made(0, to, (v) => Math.cbrt(v / to), (t) => to * t ** 3);
  }
  const most = Math.min(high, 2 * Math.abs(value) || 1000);
  return made(-most, most, (v) => (v + most) / (2 * most), (t) => (2 * t - 1) * most);
}

function listControl(row, field, place, value, id) {
  const box = document.createElement("input");
  Object.assign(box, { type: "text", id, className: "long", value: (value ?? []).join(", "), title: `numbers, ${field.unit}, separated by commas` });
  box.addEventListener("change", () => {
    const numbers = box.value.split(/[,;\s]+/).filter(Boolean).map(Number);
    if (numbers.some((x) => !Number.isFinite(x))) { problem(`[${place[0]}] ${place.slice(1).join(".")} must be numbers; got ${box.value}.`); return; }
    put(place, numbers); commit(); ask();
  });
  row.append(unitOf(field), document.createElement("span"), box);
}

function truthControl(row, field, place, value, id) {
  const box = document.createElement("input");
  Object.assign(box, { type: "checkbox", id, checked: Boolean(value) });
  box.addEventListener("change", () => { put(place, box.checked); commit(); ask(); });
  row.append(box, unitOf(field));
}

function choiceControl(row, field, place, value, id, choices = field.choices) {
  const box = document.createElement("select");
  box.id = id; box.className = "long";
  for (const choice of choices) box.add(new Option(choice, choice, false, choice === value));
  box.addEventListener("change", () => { put(place, box.value); commit(); ask(); });
  row.append(box);
}

function textControl(row, field, place, value, id) {
  if (field.key === "path") { choiceControl(row, field, place, value, id, photographs); return; }
  const box = document.createElement("input");
  Object.assign(box, { type: "text", id, className: "long", value: value ?? "", maxLength: 500 });
  box.addEventListener("change", () => { put(place, box.value); commit(); ask(); });
  row.append(box);
}

// ---------- table and pins

function showTable() {
  const head = document.createElement("tr");
  for (const text of [`${comparison.columns[0]}; ticked ones are drawn`, ...comparison.columns.slice(1)]) { const cell = document.createElement("th"); cell.textContent = text; head.append(cell); }
  document.querySelector("thead").replaceChildren(head);
  document.querySelector("tbody").replaceChildren(...comparison.rows.map((row) => {
    const line = document.createElement("tr"), name = document.createElement("td"), chosen = state.rows.includes(row.name);
    line.className = chosen ? "chosen" : "";
    line.dataset.name = row.name;
    name.append(checkbox(row.cells[0], chosen, (on) => choose(row.name, on)));
    line.append(name);
    for (const text of row.cells.slice(1)) { const cell = document.createElement("td"); cell.textContent = text; line.append(cell); }
    return line;
  }));
  $("answer").textContent = comparison.answer;
  $("ceiling").textContent = `No single exposure exceeds ${decibel(comparison.ceiling)}, whatever its path, shutter and linear decoder. Gain is over the best snapshot, at rest or panned.`;
  $("notes").replaceChildren(...comparison.notes.map((note) => { const item = document.createElement("li"); item.textContent = note; return item; }));
}

function choose(name, on) {
  state.rows = state.rows.filter((n) => n !== name);
  if (on) {
    if (state.rows.length >= most.rows) { delete curves[state.rows.shift()]; }
    state.rows.push(name); styleOf(name);
  } else if (name !== OPTIMISED) delete curves[name];
  remember(); showTable(); ask();
}

function showPins() {
  $("pins").replaceChildren(...pins.map((name) => {
    const item = document.createElement("span"), away = document.createElement("button");
    away.textContent = "×"; away.title = `Take ${name} away`; away.setAttribute("aria-label", away.title);
    away.addEventListener("click", () => { state.rows = state.rows.filter((n) => n !== name); delete curves[name]; send({ kind: "unpin", name }); });
    item.append(name, away);
    return item;
  }));
  buttons();
}

// ---------- photographs

// The decoder's knowledge of the speed: known, or found in the capture, with its error where it is trusted and
// with the doubt where it is not.
function speedKnown({ aside, found }) {
  if (!found) return aside;
  if (found.tells_nothing) return `; no speed found: ${found.doubt}`;
  const speed = `${rounded(found.speed, 0)} ± ${rounded(found.error, 0)} px/s`;
  return found.trusted ? `; speed found: ${speed}` : `; speed in doubt, ${speed}: ${found.doubt}`;
}

async function photograph(message) {
  const pictures = [{ title: `the scene, at rest`, data: message.reference }];
  for (const d of message.designs) {
    pictures.push({ title: `${d.name}, captured at ${message.speed} px/s, brightened`, data: d.captured });
    pictures.push({ title: `${d.name}, restored: ${decibel(d.psnr)}, linear light${speedKnown(d)}`, data: d.restored });
  }
  const images = await Promise.all(pictures.map(({ data }) => new Promise((resolve) => {
    const image = new Image();
    image.onload = () => resolve(image);
    image.onerror = () => resolve(null);
    image.src = `data:image/png;base64,${data}`;
  })));
  shots = pictures.map(({ title }, i) => ({ title, image: images[i] })).filter((s) => s.image);
  $("panels").replaceChildren(...shots.map((shot) => {
    const figure = document.createElement("figure"), caption = document.createElement("figcaption");
    caption.textContent = shot.title;
    shot.canvas = document.createElement("canvas");
    shot.canvas.width = shot.image.width * 2; shot.canvas.height = shot.image.height * 2;
    shot.canvas.setAttribute("role", "img"); shot.canvas.setAttribute("aria-label", shot.title);
    shot.canvas.addEventListener("pointermove", (event) => {
      const box = shot.canvas.getBoundingClientRect();
      lens = { u: (event.clientX - box.left) / box.width, v: (event.clientY - box.top) / box.height };
      showShots();
    });
    shot.canvas.addEventListener("pointerleave", () => { lens = null; showShots(); });
    figure.append(shot.canvas, caption);
    return figure;
  }));
  showShots();
  fade($("panels"), false);
  say("");
  count("photograph");
}

// The same place, magnified, in every picture: what one design lost shows beside what another kept.
function showShots() {
  for (const { canvas, image } of shots) {
    const context = canvas.getContext("2d");
    context.imageSmoothingEnabled = true;
    context.drawImage(image, 0, 0, canvas.width, canvas.height);
    if (!lens) continue;
    const zoom = Number($("zoom").value), side = Math.min(canvas.height * 0.86, 200);
    const x = lens.u * canvas.width, y = lens.v * canvas.height, taken = (side / zoom) * (image.width / canvas.width) * 2;
    const left = Math.max(0, Math.min(canvas.width - side, x - side / 2)), top = Math.max(0, Math.min(canvas.height - side, y - side / 2));
    const from = [lens.u * image.width - taken / 2, lens.v * image.height - taken / 2].map((a, i) => Math.max(0, Math.min((i ? image.height : image.width) - taken, a)));
    context.imageSmoothingEnabled = false;
    context.drawImage(image, ...from, taken, taken, left, top, side, side);
    for (const [colour, width] of [["#000", 4], ["#fff", 1.5]]) { context.strokeStyle = colour; context.lineWidth = width; context.strokeRect(left, top, side, side); }
  }
}

function uploaded(message) {
  photographs = message.photographs;
  state.scene.picture = { path: message.path };
  problem(null); showFields(); commit(); ask();
}

function upload(file) {
  if (!file) return;
  if (file.size > MOST_UPLOAD) { problem(`a photograph must hold at most 32 MiB; got ${(file.size / 2 ** 20).toFixed(0)} MiB.`); return; }
  file.arrayBuffer().then((content) => { send({ kind: "upload", name: file.name }); socket.send(content); });
}

// ---------- files

function loaded(message) {
  state.scene = message.scene;
  problem(null); showFields(); commit(); ask();
}

const saved = (name) => (message) => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([message.text], { type: "text/plain" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
};

function recipe(message) {
  $("command").textContent = message.command;
  $("python").textContent = message.python;
  $("commands").showModal();
}

async function copy(id, button) {
  try { await navigator.clipboard.writeText($(id).textContent); button.textContent = "Copied"; } catch {
    getSelection().selectAllChildren($(id));
    button.textContent = "Selected: copy it";
  }
  setTimeout(() => { button.textContent = "Copy"; }, 1500);
}

function chooseFile(input, use) {
  $(input).addEventListener("change", async () => { const file = $(input).files[0]; $(input).value = ""; if (file) await use(file); });
  return () => $(input).click();
}

// ---------- listeners

$("fields").addEventListener("submit", (event) => event.preventDefault());
$("undo").addEventListener("click", takeBack);
document.addEventListener("keydown", (event) => {
  if ((event.ctrlKey || event.metaKey) && event.key === "z" && !event.target.matches("input[type=number], input[type=text]")) { event.preventDefault(); takeBack(); }
});
$("draw").addEventListener("click", () => {
  drawing = !drawing;
  $("draw").setAttribute("aria-pressed", String(drawing));
  $("charts").classList.toggle("drawing", drawing);
});
$("clear").addEventListener("click", () => { state.drawn = null; delete curves[DRAWN]; state.rows = state.rows.filter((n) => n !== DRAWN); $("clear").disabled = true; commit(); drawCharts(); ask(); });
$("profile").addEventListener("pointerdown", beginStroke);
$("profile").addEventListener("pointermove", (event) => { if (stroke) strokeTo(event); });
$("profile").addEventListener("pointerup", endStroke);
$("profile").addEventListener("pointercancel", endStroke);
$("pin").addEventListener("click", () => send({ kind: "pin", name: `pin ${pins.length + 1}` }));
$("save-design").addEventListener("click", () => send({ kind: "save_design", scene: state.scene }));
$("save-scene").addEventListener("click", () => send({ kind: "save_scene", scene: state.scene }));
$("recipe").addEventListener("click", () => send({ kind: "recipe", scene: state.scene, drawn: state.drawn }));
$("load-scene").addEventListener("click", chooseFile("scene-file", async (file) => send({ kind: "load_scene", name: file.name, text: (await file.text()).slice(0, 1 << 20) })));
$("load-design").addEventListener("click", chooseFile("design-file", async (file) => send({ kind: "load_design", name: file.name, text: (await file.text()).slice(0, 1 << 20) })));
$("upload").addEventListener("click", chooseFile("picture-file", upload));
$("speed").addEventListener("change", () => {
  const to = Number($("speed").value);
  if (!Number.isFinite(to)) return;
  state.speed = to; remember(); ask();
});
$("zoom").addEventListener("change", showShots);
for (const button of document.querySelectorAll("[data-copy]")) button.addEventListener("click", () => copy(button.dataset.copy, button));
let resizing = null;
addEventListener("resize", () => { clearTimeout(resizing); resizing = setTimeout(drawCharts, 100); });
connect();
