// Menus, sliders, pointer and keys; the last file, which starts the page.

const WHEEL = 1.0015;
const TAP = 6; // pixels that a click may move

function refresh() {
  draw();
  drawLegend();
  showPoint(state.hovered);
}

// Choose a point and integrate its motion.
function choose(index) {
  state.chosen = index.slice();
  state.hovered = null;
  drawMarks();
  showPoint(null);
  announce(index);
  showMotion(state.chosen);
  writeAddress();
  // To the widget around the page, if there is one.
  if (parent !== window) parent.postMessage({ point: Object.fromEntries(coordinatesOf(index).map(({ dim, value }) => [dim, value])) }, "*");
}

// The address of the page names variable and point, "#variable=label&m=0.5&h3=1", so that a link leads to both.
function writeAddress() {
  const names = new URLSearchParams({ variable: state.variable.name });
  if (data.points && state.chosen) names.set("point", state.chosen[0]);
  else if (state.chosen) data.shape.forEach((_, k) => names.set(data.axes[k].name, data.axes[k].values[state.chosen[k]]));
  try {
    history.replaceState(null, "", `#${names}`);
  } catch {
    // Within a notebook the page has no address.
  }
}

function readAddress() {
  const names = new URLSearchParams(location.hash.slice(1));
  const variable = data.variables.findIndex((each) => each.name === names.get("variable"));
  if (variable >= 0) {
    byId("variable").value = String(variable);
    byId("variable").dispatchEvent(new Event("change"));
  }
  const nearest = (values, value) => values.reduce((best, each, i) => (Math.abs(each - value) < Math.abs(values[best] - value) ? i : best), 0);
  const places = data.shape.map((size, k) => {
    const value = Number.parseFloat(names.get(data.points ? "point" : data.axes[k].name));
    return data.points ? (value >= 0 && value < size ? Math.floor(value) : NaN) : Number.isNaN(value) ? NaN : nearest(data.axes[k].values, value);
  });
  if (places.some(Number.isNaN)) return;
  further.forEach((axis, i) => {
    const slider = byId("sliders").querySelectorAll("input")[i];
    slider.value = String(places[axis]);
    slider.dispatchEvent(new Event("input"));
  });
  choose(places);
}

// Menus and sliders.

function buildVariables() {
  const menu = byId("variable");
  const groups = { motion: "Measured", theory: "Theory", numerics: "Numerics" };
  for (const [group, title] of Object.entries(groups)) {
    const members = data.variables.filter((each) => each.group === group);
    if (!members.length) continue;
    const list = element("optgroup", { label: title });
    for (const variable of members) {
      list.append(element("option", { value: String(data.variables.indexOf(variable)), title: variable.text }, variable.plain));
    }
    menu.append(list);
  }
  menu.value = String(data.variables.indexOf(state.variable));
  menu.addEventListener("change", () => {
    const wasLine = isLine();
    state.variable = data.variables[Number(menu.value)];
    if (flat && (wasLine || isLine())) state.view = null;
    refresh();
    writeAddress();
  });
}

// Of single points: which coordinates the map shows.
function buildAxisMenus() {
  if (!data.points) return;
  ["x", "y"].forEach((title, which) => {
    const menu = element("select", { "aria-label": `${title} axis` });
    data.axes.forEach((axis, k) => menu.append(element("option", { value: String(k) }, axis.plain)));
    menu.value = String(state.axes[which]);
    menu.addEventListener("change", () => {
      state.axes[which] = Number(menu.value);
      state.view = null;
      refresh();
    });
    byId("places").append(element("label", {}, ` ${title} `, menu, " "));
  });
}

function buildSliders() {
  for (const axis of further) {
    const { symbol, plain, values } = data.axes[axis];
    const output = element("output");
    const slider = element("input", {
      type: "range", min: "0", max: String(values.length - 1), step: "1", value: String(state.index[axis]), "aria-label": plain,
    });
    const show = () => {
      const text = numberText(values[state.index[axis]]);
      output.replaceChildren(formula(symbol), ` = ${text}`);
      slider.setAttribute("aria-valuetext", text);
    };
    slider.addEventListener("input", () => {
      state.index[axis] = Number(slider.value);
      if (state.chosen) state.chosen[axis] = state.index[axis];
      state.hovered = null;
      show();
      refresh();
    });
    slider.addEventListener("change", () => {
      if (state.chosen) choose(state.chosen);
    });
    show();
    byId("sliders").append(element("label", {}, output, slider));
  }
}

const THEMES = ["auto", "light", "dark"];
const darkness = window.matchMedia("(prefers-color-scheme: dark)");
let theme = 0;

function applyTheme() {
  const name = THEMES[theme];
  const dark = name === "dark" || (name === "auto" && darkness.matches);
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  const button = byId("theme");
  button.textContent = `◐ ${name}`;
  button.setAttribute("aria-label", `Colours: ${name === "auto" ? "as the system" : name}`);
}

function redrawAll() {
  applyTheme();
  refresh();
  if (lastMotion && byId("plots").childElementCount) drawMotion(lastMotion);
}

// Zoom and movement.

function setView(x, y) {
  const whole = wholeView();
  const limited = ([low, high], [first, last]) => {
    const span = Math.min(high - low, last - first);
    const start = Math.min(Math.max(low, first), last - span);
    return [start, start + span];
  };
  state.view = [limited(x, whole[0]), flat ? whole[1] : limited(y, whole[1])];
  const zoomed = state.view.some(([low, high], k) => high - low < 0.999 * (whole[k][1] - whole[k][0]));
  marks.style.touchAction = zoomed ? "none" : "pan-y";
  draw();
}

// Divide the extent of the map by a factor, about a place in pixels.
function zoom(factor, x = box.left + box.width / 2, y = box.top + box.height / 2) {
  const scaled = ([low, high], centre) => {
    const span = Math.max((high - low) / factor, 1e-9 * Math.abs(centre) + 1e-300);
    const start = centre - ((centre - low) / (high - low)) * span;
    return [start, start + span];
  };
  setView(scaled(state.view[0], xValue(x)), scaled(state.view[1], yValue(y)));
}

function move(dx, dy) {
  const [x, y] = state.view;
  const across = (-dx / box.width) * (x[1] - x[0]);
  const along = (dy / box.height) * (y[1] - y[0]);
  setView(x.map((value) => value + across), y.map((value) => value + along));
}

// Pointer.

const pointers = new Map();
let travelled = 0;

const local = (event) => {
  const frame = marks.getBoundingClientRect();
  return [event.clientX - frame.left, event.clientY - frame.top];
};

function onDown(event) {
  marks.setPointerCapture(event.pointerId);
  if (!pointers.size) travelled = 0;
  pointers.set(event.pointerId, local(event));
}

function onMove(event) {
  const place = local(event);
  const before = pointers.get(event.pointerId);
  if (!before) {
    hover(indexAt(...place));
    return;
  }
  const others = [...pointers.entries()].filter(([id]) => id !== event.pointerId);
  travelled += Math.hypot(place[0] - before[0], place[1] - before[1]);
  pointers.set(event.pointerId, place);
  if (others.length) {
    const [, other] = others[0];
    const ratio = Math.hypot(place[0] - other[0], place[1] - other[1]) / (Math.hypot(before[0] - other[0], before[1] - other[1]) || 1);
    zoom(ratio, 0.5 * (place[0] + other[0]), 0.5 * (place[1] + other[1]));
  } else if (travelled > TAP) {
    move(place[0] - before[0], place[1] - before[1]);
  }
}

function onUp(event) {
  const place = local(event);
  const single = pointers.size === 1;
  pointers.delete(event.pointerId);
  if (event.type === "pointerup" && single && travelled <= TAP) {
    const index = indexAt(...place);
    if (index) choose(index);
  }
  if (single) travelled = 0;
  else travelled = TAP + 1; // the last finger of a pinch chooses nothing
}

function hover(index) {
  if (index === state.hovered || isSame(index, state.hovered)) return;
  state.hovered = index;
  drawMarks();
  showPoint(index);
}

// Keys.

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

function onKey(event) {
  const from = state.hovered || state.chosen || middle();
  const stride = event.shiftKey ? 10 : 1;
  if (ARROWS[event.key]) {
    const next = state.hovered || state.chosen ? neighbour(from, ARROWS[event.key], stride) : from;
    hover(next);
    announce(next);
  } else if (event.key === "Enter" || event.key === " ") {
    choose(from);
  } else if (event.key === "+" || event.key === "=") {
    zoom(1.5);
  } else if (event.key === "-") {
    zoom(1 / 1.5);
  } else if (event.key === "0") {
    showAll();
  } else if (event.key === "Escape") {
    hover(null);
  } else {
    return;
  }
  event.preventDefault();
}

function middle() {
  const index = state.index.slice();
  if (data.points) return [0];
  for (const axis of data.map) index[axis] = data.shape[axis] >> 1;
  return index;
}

// The cell beside one; of single points the nearest one in that direction.
function neighbour(index, [dx, dy], stride) {
  if (!data.points) {
    const next = index.slice();
    const shift = (axis, by) => { next[axis] = Math.min(Math.max(next[axis] + by * stride, 0), data.shape[axis] - 1); };
    shift(data.map[0], dx);
    if (!flat) shift(data.map[1], dy);
    return next;
  }
  const [x, y] = pixelOf(index);
  let best = index;
  let smallest = Infinity;
  for (let i = 0; i < data.shape[0]; i++) {
    const [px, py] = pixelOf([i]);
    const along = (px - x) * dx - (py - y) * dy;
    const across = (px - x) * dy + (py - y) * dx;
    if (!(along > 0.5) || Math.abs(across) > 2 * along) continue;
    const distance = along + 2 * Math.abs(across);
    if (distance < smallest) [best, smallest] = [[i], distance];
  }
  return best;
}

function showAll() {
  state.view = null;
  marks.style.touchAction = "pan-y";
  draw();
}

// The map and its legend as a PNG file, with the mark of the chosen point.
function savePicture() {
  const ratio = map.width / map.clientWidth;
  const [width, margin, row] = [map.clientWidth, 12, 20];
  const font = "13px system-ui, sans-serif";
  const picture = element("canvas");
  const context = picture.getContext("2d");
  context.font = font;
  let [x, y] = [margin, map.clientHeight + row];
  const entries = [...byId("legend").children].map((item) => {
    const text = [...item.querySelectorAll("span")].map((part) => part.textContent).join(" ");
    const length = 34 + context.measureText(text).width;
    if (x > margin && x + length > width - margin) [x, y] = [margin, y + row];
    x += length + margin;
    return { sample: item.querySelector("canvas"), text, left: x - length - margin, middle: y };
  });
  [picture.width, picture.height] = [map.width, Math.round(ratio * (y + row))];
  context.fillStyle = colour("paper");
  context.fillRect(0, 0, picture.width, picture.height);
  for (const layer of [map, marks]) context.drawImage(layer, 0, 0);
  context.scale(ratio, ratio);
  [context.font, context.fillStyle, context.textBaseline] = [font, colour("ink"), "middle"];
  for (const { sample, text, left, middle } of entries) {
    context.drawImage(sample, left, middle - 6.5, 26, 13);
    context.fillText(text, left + 32, middle);
  }
  picture.toBlob((blob) => {
    const link = element("a", { href: URL.createObjectURL(blob), download: `${state.variable.name}.png` });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  });
}

// Start.

function addListeners() {
  marks.addEventListener("pointerdown", onDown);
  marks.addEventListener("pointermove", onMove);
  marks.addEventListener("pointerup", onUp);
  marks.addEventListener("pointercancel", onUp);
  marks.addEventListener("pointerleave", (event) => { if (!pointers.has(event.pointerId)) hover(null); });
  marks.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(WHEEL ** -event.deltaY, ...local(event));
  }, { passive: false });
  marks.addEventListener("dblclick", (event) => zoom(2, ...local(event)));
  marks.addEventListener("keydown", onKey);
  byId("zoom-in").addEventListener("click", () => zoom(1.5));
  byId("zoom-out").addEventListener("click", () => zoom(1 / 1.5));
  byId("zoom-all").addEventListener("click", showAll);
  byId("save-picture").addEventListener("click", savePicture);
  byId("controls").addEventListener("submit", (event) => event.preventDefault());
  byId("theme").addEventListener("click", () => {
    theme = (theme + 1) % THEMES.length;
    redrawAll();
  });
  darkness.addEventListener("change", redrawAll);
  let timer = 0;
  let width = byId("frame").clientWidth;
  new ResizeObserver(() => {
    if (byId("frame").clientWidth === width) return; // its height is set by draw()
    width = byId("frame").clientWidth;
    clearTimeout(timer);
    timer = setTimeout(redrawAll, 60);
  }).observe(byId("frame"));
}

async function start() {
  applyTheme();
  byId("subtitle").textContent = data.frame ? `${data.system}, motion in the ${data.frame} frame` : data.system;
  byId("notes").replaceChildren(...data.notes.map((runs) => element("p", {}, formula(runs))));
  const footer = [data.caption, data.caption ? "" : data.reference].filter(Boolean);
  byId("footer").replaceChildren(...footer.map((text) => element("p", {}, text)));
  byId("main").hidden = false;
  if (!window.DecompressionStream) {
    byId("place").textContent = "This browser is too old for this page: it has no DecompressionStream.";
    return;
  }
  arrays = await Promise.all(data.arrays.map(unpack));
  state.variable = data.variables.find((each) => each.name === data.variable) || data.variables[0];
  buildVariables();
  buildAxisMenus();
  buildSliders();
  buildValues();
  addListeners();
  refresh();
  readAddress();
  addEventListener("hashchange", readAddress);
  performance.mark("map drawn");
  document.documentElement.dataset.ready = "yes";
}

// For the console of the browser and for tests: the motion of a point by its indices along the axes.
window.atlasPage = { data, motionOf, choose };
start();
