"use strict";
// Bokeh draws; this script joins its figures to the page's controls. Text goes in by textContent.
const find = (selector, within = document) => within.querySelector(selector);
const every = (selector, within = document) => [...within.querySelectorAll(selector)];
const read = name => JSON.parse(find(`#data-${name}`).textContent);
const made = (tag, text, parts = {}) => Object.assign(document.createElement(tag), {textContent: text, ...parts});
const plots = new Map();
const data = read("runs");

// Figures: made in order, one at a time, so that the first can be seen before the last is made.
async function draw(place) {
  if (!plots.has(place)) plots.set(place, Bokeh.embed.embed_item(read(place.dataset.item), place)
    .then(views => inked(views.roots[0].model)));
  return plots.get(place);
}
// Numbers and names are as dark, or as light, as the page's own small print.
function inked(plot) {
  const ink = getComputedStyle(document.documentElement).getPropertyValue("--dim").trim();
  for (const r of plot.renderers) if (r.glyph.text_color && [INK, r.glyph.inked].includes(r.glyph.text_color.value))
    for (const glyph of [r.glyph, r.selection_glyph, r.nonselection_glyph])
      if (glyph?.text_color) { glyph.inked = ink; glyph.text_color = {value: ink}; }
  for (const part of [...plot.left, ...plot.below, ...plot.center])
    for (const own of ["major_label_text_color", "label_text_color"]) if (own in part) part[own] = ink;
  return plot;
}
const INK = data.ink;
for (const paper of ["(prefers-color-scheme:dark)", "print"])
  matchMedia(paper).addEventListener("change", () => plots.forEach(plot => plot.then(inked)));

// Both axes of a map have one scale, whatever the shape of its picture.
function show(plot, box) {
  const middle = [(box[0] + box[1]) / 2, (box[2] + box[3]) / 2];
  const [wide, high] = [plot.inner_width, plot.inner_height];
  if (!(wide > 0 && high > 0)) return;  // it is not shown yet
  const half = Math.max((box[1] - box[0]) / wide, (box[3] - box[2]) / high) / 2;
  plot.x_range.setv({start: middle[0] - half * wide, end: middle[0] + half * wide});
  plot.y_range.setv({start: middle[1] - half * high, end: middle[1] + half * high});
}
const shown = plot => [plot.x_range.start, plot.x_range.end, plot.y_range.start, plot.y_range.end];
function zoom(plot, by, aside = 0, up = 0) {
  const [left, right, low, high] = shown(plot);
  const [x, y] = [(left + right) / 2 + aside * (right - left), (low + high) / 2 + up * (high - low)];
  const [w, h] = [by * (right - left) / 2, by * (high - low) / 2];
  show(plot, [x - w, x + w, y - h, y + h]);
}
const KEYS = {"+": [.67], "=": [.67], "-": [1.5], ArrowLeft: [1, -.15], ArrowRight: [1, .15],
  ArrowUp: [1, 0, .15], ArrowDown: [1, 0, -.15]};

// Dots and lines shrink where corridors are drawn shorter than this [px].
const LARGE_PX = 30, LEAST = .25;
// Numbers that would lie over an earlier one are left out: each takes cells of the picture [px].
const CELL_PX = 6, LETTER_PX = 7, HIGH_PX = 11;
function renumber(plot, px_per_m) {
  const taken = new Set();
  for (const r of plot.renderers) if (r.glyph.text) {
    const source = r.data_source, back = r.glyph.text_align.value === "right";
    if (source.data.text !== source.fewer) source.every = source.data.text;
    const cells = (text, k) => {
      const wide = LETTER_PX * text.length;
      const x = source.data.x[k] * px_per_m + r.glyph.x_offset.value - back * wide;
      const y = source.data.y[k] * px_per_m - r.glyph.y_offset.value;
      const across = Math.floor(x / CELL_PX), up = Math.floor(y / CELL_PX), out = [];
      for (let i = across; i * CELL_PX < x + wide; i++) for (let j = up; j * CELL_PX < y + HIGH_PX; j++) out.push(`${i},${j}`);
      return out;
    };
    source.fewer = source.every.map((text, k) => {
      const own = cells(text, k);
      if (own.some(cell => taken.has(cell))) return "";
      own.forEach(cell => taken.add(cell));
      return text;
    });
    source.data = {...source.data, text: source.fewer};
  }
}
function rescale(plot) {
  const px_per_m = plot.inner_width / (plot.x_range.end - plot.x_range.start), usual_px = plot.usual * px_per_m;
  if (!(usual_px > 0)) return;
  if (!(Math.abs(px_per_m / plot.px_per_m - 1) < .05)) renumber(plot, plot.px_per_m = px_per_m);
  const scale = Math.min(1, Math.max(LEAST, usual_px / LARGE_PX));
  for (const r of plot.renderers) {
    if (Math.abs(scale - (plot.scale ?? 0)) < .05) continue;
    for (const glyph of [r.glyph, r.selection_glyph, r.nonselection_glyph])
      for (const part of ["size", "line_width", "length"]) if (typeof glyph?.[part]?.value === "number") {
        glyph.full ??= {};
        glyph.full[part] ??= glyph[part].value;
        glyph[part] = {...glyph[part], value: scale * glyph.full[part]};
      }
  }
  if (Math.abs(scale - (plot.scale ?? 0)) >= .05) plot.scale = scale;
}

async function map(place) {
  const plot = await draw(place);
  plot.box = shown(plot);
  plot.usual = plot.tags[0] ?? 1;
  const fit = () => show(plot, plot.box);
  for (const side of ["inner_width", "inner_height"]) plot.properties[side].change.connect(fit);
  plot.x_range.change.connect(() => rescale(plot));
  fit();
  rescale(plot);
  place.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "0") fit();
    else if (event.key in KEYS) zoom(plot, ...KEYS[event.key]);
    else return;
    event.preventDefault();
  });
  for (const button of every("[data-zoom]", place.parentElement))
    button.onclick = () => +button.dataset.zoom ? zoom(plot, +button.dataset.zoom) : fit();
  return plot;
}

async function site(place) {
  const plot = await map(place), section = place.parentElement, about = find(".about", section);
  const hint = about.textContent, sources = plot.renderers.map(r => r.data_source).filter(s => s.data.lines);
  const tell = () => {
    const lines = sources.flatMap(s => s.selected.indices.map(k => s.data.lines[k])).reverse();
    about.replaceChildren(...lines.length ? lines.map(line => made("div", line)) : [hint]);
  };
  for (const source of sources) source.selected.properties.indices.change.connect(tell);
  const layers = new Map();
  for (const r of plot.renderers) if (r.name) layers.set(r.name, [...layers.get(r.name) ?? [], r]);
  for (const [name, renderers] of layers) {
    const box = made("input", "", {type: "checkbox", checked: true}), label = made("label", "");
    const {glyph} = renderers[0], mark = made("i", "");
    const ink = (glyph.fill_color ?? glyph.line_color)?.value;
    mark.dataset.mark = glyph.marker?.value ?? "line";
    if (glyph.marker && !glyph.fill_color?.value) mark.className = "ring";
    mark.style.color = ink;
    box.onchange = () => renderers.forEach(r => { r.visible = box.checked; });
    label.append(box, " ", ...ink ? [mark] : [], name);
    find(".layers", section).append(label);
  }
  const points = sources.filter(s => s.data.x), numbers = plot.renderers.filter(r => r.glyph.text).map(r => r.data_source);
  const choose = (source, k) => sources.forEach(s => { s.selected.indices = s === source ? [k] : []; });
  // A finger is wider than a dot: what is near enough counts as hit.
  plot.on_event("tap", event => setTimeout(() => {
    const metres = NEAR_PX * (plot.x_range.end - plot.x_range.start) / plot.inner_width;
    let best = [metres];
    for (const s of points) s.data.x.forEach((_, k) => {
      const away = Math.hypot(s.data.x[k] - event.x, s.data.y[k] - event.y);
      if (away < best[0]) best = [away, s, k];
    });
    if (best[1]) choose(best[1], best[2]);
  }));
  find(".find", section).onchange = event => {
    const number = String(+event.target.value), all = s => s.every ?? s.data.text;
    const named = numbers.find(s => all(s).includes(number));
    if (!named) return void about.replaceChildren(`No junction ${event.target.value} here.`);
    const at = all(named).indexOf(number), [x, y] = [named.data.x[at], named.data.y[at]], half = 4 * plot.usual;
    const is = k => s => s.data.x[k] === x && s.data.y[k] === y;
    const source = points.find(s => s.data.x.some((_, k) => is(k)(s))), k = source.data.x.findIndex((_, k) => is(k)(source));
    choose(source, k);
    show(plot, [x - half, x + half, y - half, y + half]);
  };
}
const NEAR_PX = 12;

// Pairs.
const JOINED = "joined through others";
const n = data.runs.length, both = (i, j) => Math.min(i, j) * n + Math.max(i, j);
const pairs = new Map(data.pairs.map(p => [both(p.i, p.j), p])), pair = (i, j) => pairs.get(both(i, j));
function spelled(i, j) {
  const [a, b] = [data.runs[i], data.runs[j]], p = pair(i, j);
  if (i === j) return a.name;
  const names = `${a.name} + ${b.name}: `;
  if (p) return names + data.standings[p.s] + (data.standings[p.s] === JOINED ? "" : `, ${p.bits} bits`);
  if (data.counted && a.site !== undefined && b.site !== undefined)
    return `${names}${a.site === b.site ? JOINED : "unrelated"}; a large merge does not list it`;
  return `${names}not merged together`;
}
const turned = (t, x, y) => [t[0] + Math.cos(t[2]) * x - Math.sin(t[2]) * y,
  t[1] + Math.sin(t[2]) * x + Math.cos(t[2]) * y];
const composed = (s, t) => [...turned(s, t[0], t[1]), s[2] + t[2]];
const laid = (m, t) => ({
  dots: m.x.map((x, k) => turned(t, x, m.y[k])),
  paths: m.paths.map(([xs, ys]) => xs.map((x, k) => turned(t, x, ys[k]))),
});
const lines = paths => ({xs: paths.map(p => p.map(q => q[0])), ys: paths.map(p => p.map(q => q[1]))});
const dots = points => ({x: points.map(q => q[0]), y: points.map(q => q[1])});

function fill(plot, a, b, placed, record) {
  const upright = [0, 0, a.map.turn], one = laid(a.map, upright), [of, ends, advised] = record ?? [0, [], [[], []]];
  const two = b ? laid(b.map, composed(upright, placed.t)) : {dots: [], paths: []};
  const spots = placed?.spots ?? [], both = [one.dots, two.dots];
  const alone = spots.flatMap(spot => spot.map((ends, k) => ends.length === 1 ? [both[k][ends[0]]] : []).flat());
  const crossing = spots.filter(s => s.every(ends => ends.length === 2))
    .flatMap(spot => spot.map((ends, k) => ends.map(v => both[k][v])));
  // What the advice names and matched junctions first, where there is no room for all.
  const numbers = (side, m) => {
    const ks = [...new Set([...of === side ? ends : [], ...(placed?.ties ?? []).map(t => t[side]), ...Array(m?.junctions ?? 0).keys()])];
    return {...dots(ks.map(k => both[side][k])), text: ks.map(String)};
  };
  const asked = advised[0].map((xs, k) => xs.map((x, i) =>
    turned(of ? composed(upright, placed.t) : upright, x, advised[1][k][i])));
  const filled = {
    record: lines(asked),
    a: lines(one.paths), b: lines(two.paths), "a dots": dots(one.dots), "b dots": dots(two.dots),
    ties: lines((placed?.ties ?? []).map(([u, v]) => [one.dots[u], two.dots[v]])),
    links: lines((placed?.links ?? []).map(ends => ends.map(v => one.dots[v]))),
    against: dots(alone), crossing: lines(crossing), "a numbers": numbers(0, a.map), "b numbers": numbers(1, b?.map),
  };
  for (const {data_source: source} of plot.renderers) source.data = filled[source.name];
  const points = [...one.dots, ...one.paths.flat(), ...two.dots, ...two.paths.flat()];
  const all = k => points.map(q => q[k]), low = k => Math.min(...all(k)), high = k => Math.max(...all(k));
  const spare = .05 * Math.max(high(0) - low(0), high(1) - low(1), 4);
  plot.usual = a.map.usual;
  plot.box = [low(0) - spare, high(0) + spare, low(1) - spare, high(1) + spare];
  plot.px_per_m = 0;  // what is numbered is new
  show(plot, plot.box);
  rescale(plot);
}
function command(place, words, when) {
  const field = made("code", words), button = made("button", "copy", {type: "button"});
  button.onclick = () => { getSelection().selectAllChildren(field); document.execCommand("copy"); button.textContent = "copied"; };
  place.replaceChildren(made("span", when), field, button);
}
function evidence(p) {
  const table = find("#evidence"), rows = p?.rows ?? [];
  table.replaceChildren();
  if (!rows.length) return;
  const row = (cells, tag, kind = "") => {
    const line = made("tr", "", {className: kind});
    line.append(...cells.map((cell, k) => made(tag, cell, {className: k ? "" : kind === "part" ? "words part" : "words"})));
    table.append(line);
  };
  const [a, b] = [data.runs[p.i].name, data.runs[p.j].name];
  const sides = p.placed?.length > 1 ? ["bits", "next best"] : ["bits"];
  row(["evidence", `in ${a}`, `in ${b}`, ...sides], "th");
  for (const [level, text, u, v, ...bits] of rows)
    row([text, u, v, ...sides.map((_, k) => bits[k] ?? "")], "td", level ? "part" : "");
  row(["sum", "", "", ...p.placed.map(q => q.bits)], "td", "sum");
}
async function open(i, j) {
  const alone = j === undefined || i === j;
  find("#run-a").value = i;
  if (find("#run-b")) find("#run-b").value = alone ? "" : j;
  const p = alone ? null : pair(i, j);
  if (p) [i, j] = [p.i, p.j];  // the second is placed in the first one's frame
  const [a, b] = [data.runs[i], alone ? null : data.runs[j]], verdict = find("#pair-verdict"), call = words => `topobatch ${words} ${data.where}`.trim();
  find("#pair-title").textContent = alone ? a.name : spelled(i, j);
  const sentences = p?.lines ?? (p ? [data.reasons[p.r], p.advice && `To settle it: ${p.advice}`] : []);
  const lines = [...sentences, p?.locked && `Decided by a person: ${p.locked}.`].filter(Boolean);
  if (p && !p.rows) lines.push(`The evidence line by line: ${call(`explain ${a.shell} ${b.shell}`)}`);
  verdict.replaceChildren(...lines.map(line => made("p", line)));
  const placed = p?.placed ?? [], figures = every("#pair figure");
  const names = ["best placement", "next best placement"];
  if (find("#key")) find("#key").hidden = true;
  for (const [k, figure] of figures.entries()) {
    const at = placed[k], drawn = alone ? k === 0 && a.map : at && a.map && b.map;
    figure.hidden = !drawn;
    find(".copy", figure).replaceChildren();
    find(".views", figure).replaceChildren(...(at?.views ?? []).map(([words, src]) => {
      const view = made("div", words);
      view.prepend(made("img", "", {src, alt: ""}));
      return view;
    }));
    if (!drawn) continue;
    find("figcaption", figure).replaceChildren();
    if (!alone) {
      const against = at.against.length ? at.against.map(line => made("div", `against it: ${line}`)) : [];
      const keys = [[a.name, data.inks[0]], [b.name, data.inks[1]]].map(([name, ink]) => {
        const mark = made("i", ""); mark.style.background = ink;
        const key = made("span", ""); key.append(mark, `${name}  `); return key; });
      find("figcaption", figure).append(made("b", `${names[k]}: ${at.bits} bits`), made("br", ""), ...keys, ...against);
      const others = new Set((placed[1 - k]?.ties ?? []).map(String));
      const own = at.ties.find(t => !others.has(String(t)));
      const where = placed.length > 1 && own ? ` --at ${own.join(",")}` : "";
      command(find(".copy", figure), call(`lock ${a.shell} ${b.shell} --same${where}`), "if they are one place:");
      find("#key").hidden = false;
    }
    fill(await draw(find(".map", figure)), a, b, at, p?.record);
  }
  evidence(p);
  if (alone) find("#never").replaceChildren();
  else command(find("#never"), call(`lock ${a.shell} ${b.shell} --never`), "if not:");
}
async function matrix(place) {
  const plot = await draw(place), pointed = find("#pointed");
  const cell = event => {
    const [j, i] = [Math.floor(event.x), Math.floor(event.y)];
    return [i, j].every(k => k >= 0 && k < plot.x_range.end) ? [i, j] : null;
  };
  plot.on_event("mousemove", event => { const c = cell(event); pointed.textContent = c ? spelled(...c) : "\u00a0"; });
  plot.on_event("tap", event => { const c = cell(event); if (c) chosen(...c); });
  return plot;
}
let spot = null;
async function chosen(i, j) {
  if (spot) spot.data = j === undefined ? {x: [], y: []} : {x: [j + .5], y: [i + .5]};
  await open(i, j);
}
async function begin() {
  const [first, ...rest] = every("section.site .map");
  if (first) await site(first);
  requestAnimationFrame(() => performance.mark("first map"));
  for (const place of every("#pair .map")) await map(place);
  if (find("#matrix")) {
    const plot = await matrix(find("#matrix"));
    spot = plot.renderers.find(r => r.name === "spot").data_source;
  }
  const a = find("#run-a"), b = find("#run-b"), open_ = data.pairs.filter(p => data.standings[p.s] === "ambiguous");
  for (const select of [a, b].filter(Boolean))
    select.onchange = () => chosen(+a.value, b && b.value !== "" ? +b.value : undefined);
  let next = 0;
  const button = find("#undecided");
  if (button) {
    button.hidden = !open_.length;
    button.onclick = () => { const p = open_[next++ % open_.length]; return chosen(p.i, p.j); };
  }
  const least = open_[0] ?? data.pairs.find(p => p.placed);
  await (least ? chosen(least.i, least.j) : n ? chosen(0) : null);
  for (const place of rest) await site(place);
  performance.mark("all maps");
  document.documentElement.dataset.drawn = "all";
}
begin();
