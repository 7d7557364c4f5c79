// Shows the table in the element "data". `equations` are the translated functions of the system, or null.
// Texts of the atlas reach the page as text nodes only.

const data = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);

// Elements and texts.

function element(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

// Letters of equal style (see text.py) as elements.
function formula(runs) {
  const fragment = document.createDocumentFragment();
  for (const run of runs) {
    const letters = run.i ? element("i", {}, run.t) : run.t;
    fragment.append(run.s ? element(run.s > 0 ? "sup" : "sub", {}, letters) : letters);
  }
  return fragment;
}

const RAISED = { "-": "⁻", "+": "", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
const raised = (number) => [...String(number)].map((sign) => RAISED[sign]).join("");
const letters = (runs) => runs.map((run) => run.t).join("");

// A number for readers, with so many digits.
function numberText(value, digits = 6) {
  if (value === null || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  if (value === 0) return "0";
  const size = Math.abs(value);
  let text;
  if (size >= 1e-3 && size < 1e6) {
    text = String(Number(value.toPrecision(digits)));
  } else {
    const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
    const short = String(Number(mantissa));
    text = `${short === "1" ? "" : short === "-1" ? "-" : `${short} × `}10${raised(Number(exponent))}`;
  }
  return text.replace("-", "−");
}

const style = () => getComputedStyle(document.documentElement);
const colour = (name) => style().getPropertyValue(`--${name}`).trim();

// Arrays: see store.py.

let arrays = [];
const TYPES = { Int8Array, Int32Array, Float32Array, Float64Array };

async function unpack(entry) {
  const compressed = Uint8Array.from(atob(entry.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([compressed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const columns = new Uint8Array(await new Response(stream).arrayBuffer());
  const width = columns.length / entry.size;
  const bytes = new Uint8Array(columns.length);
  for (let j = 0; j < width; j++) {
    for (let i = 0; i < entry.size; i++) bytes[i * width + j] = columns[j * entry.size + i];
  }
  return new TYPES[entry.type](bytes.buffer);
}

// Value of an array at the indices of a point.
function at(reference, index) {
  let place = 0;
  for (const axis of reference.over) place = place * data.shape[axis] + index[axis];
  return arrays[reference.array][place];
}

// Offset and strides of two axes in an array: place = offset + i * strides[0] + j * strides[1].
function offsetAndStrides(reference, index, axes) {
  const strides = axes.map(() => 0);
  let offset = 0;
  let size = 1;
  for (const axis of [...reference.over].reverse()) {
    const which = axes.indexOf(axis);
    if (which >= 0) strides[which] = size;
    else offset += size * index[axis];
    size *= data.shape[axis];
  }
  return [offset, strides];
}

// Colours.

const packed = (hex) => {
  const number = parseInt(hex.replace("#", ""), 16);
  return ((255 << 24) | ((number & 255) << 16) | (number & 0xff00) | (number >> 16)) >>> 0;
};

// Position of a value on a colour scale, between 0 and 1.
function fraction(scale, value) {
  if (scale.kind === "integers") return (value - scale.low) / Math.max(scale.high - scale.low, 1e-300);
  if (scale.kind === "log") {
    if (value <= 0) return 0;
    return Math.log(value / scale.low) / Math.log(scale.high / scale.low);
  }
  return (value - scale.low) / (scale.high - scale.low);
}

// Function from values to packed colours, 0 where there is no value.
function colourMap(scale) {
  const shades = data.shades[scale.shades].map(packed);
  const last = shades.length - 1;
  return (value) => {
    if (!Number.isFinite(value)) return 0;
    const place = Math.floor(fraction(scale, value) * shades.length);
    return shades[Math.min(Math.max(place, 0), last)];
  };
}

// What is shown.

const state = {
  variable: data.variables[0],
  index: data.shape.map((size) => size >> 1), // of the further axes
  axes: data.map.slice(), // x and y, numbers of data.axes
  view: null, // [[left, right], [bottom, top]] in the units of the drawing
  chosen: null,
  hovered: null,
};
const flat = data.map.length === 1;
const further = data.points ? [] : data.shape.map((_, axis) => axis).filter((axis) => !data.map.includes(axis));
const isLine = () => flat && !state.variable.flags;
const mapAxis = (which) => data.axes[state.axes[which]];
// A value in the units of the drawing.
const toDrawing = (axis, value) => (axis.log ? Math.log(value) : value);

// Edges of the cells along an axis, in the units of the drawing.
function edges(axis) {
  const v = axis.values.map((value) => toDrawing(axis, value));
  if (v.length === 1) return [v[0] - 0.5, v[0] + 0.5];
  const inner = v.slice(1).map((value, i) => 0.5 * (value + v[i]));
  return [2 * v[0] - inner[0], ...inner, 2 * v.at(-1) - inner.at(-1)];
}

function pointRange(axis) {
  const known = axis.values.filter((value) => value !== null);
  const low = known.reduce((a, b) => Math.min(a, b));
  const high = known.reduce((a, b) => Math.max(a, b));
  const margin = 0.03 * (high - low || 1);
  return [low - margin, high + margin];
}

function wholeView() {
  if (data.points) return [pointRange(mapAxis(0)), pointRange(mapAxis(1))];
  const x = edges(mapAxis(0));
  if (flat) return [[x[0], x.at(-1)], isLine() ? lineRange() : [0, 1]];
  const y = edges(mapAxis(1));
  return [[x[0], x.at(-1)], [y[0], y.at(-1)]];
}

function lineRange() {
  const scale = state.variable.scale;
  const [low, high] = scale.kind === "log" ? [Math.log(scale.low), Math.log(scale.high)] : [scale.low, scale.high];
  const margin = 0.05 * (high - low || 1);
  return [low - margin, high + margin];
}

// Place of a value between sorted edges; -1 outside.
function cellOf(sorted, value) {
  if (!(value >= sorted[0] && value <= sorted.at(-1))) return -1;
  let low = 0;
  let high = sorted.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (sorted[middle] <= value) low = middle;
    else high = middle;
  }
  return low;
}

// Drawing.

const FONT = 'system-ui, "DejaVu Sans", sans-serif';
const map = byId("map");
const marks = byId("marks");
let box = { left: 0, top: 0, width: 1, height: 1, right: 1 };

// A canvas of the size of its element, in the units of the page.
function preparedContext(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.max(1, Math.round(width * ratio));
  canvas.height = Math.max(1, Math.round(height * ratio));
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return context;
}

function font(size, italic = false) {
  return `${italic ? "italic " : ""}${size}px ${FONT}`;
}

// Draw letters of different styles, centred at a place; angle in rad.
function drawFormula(context, runs, x, y, size, ink, angle = 0, align = 0.5) {
  const sizes = runs.map((run) => (run.s ? 0.72 * size : size));
  const widths = runs.map((run, i) => {
    context.font = font(sizes[i], run.i);
    return context.measureText(run.t).width;
  });
  context.save();
  context.translate(x, y);
  context.rotate(angle);
  context.fillStyle = ink;
  context.textAlign = "left";
  context.textBaseline = "alphabetic";
  let place = -align * widths.reduce((a, b) => a + b, 0);
  runs.forEach((run, i) => {
    context.font = font(sizes[i], run.i);
    context.fillText(run.t, place, 0.35 * size - 0.38 * size * (run.s || 0));
    place += widths[i];
  });
  context.restore();
}

// Round values between two ends, about so many.
function ticks(low, high, count) {
  const raw = (high - low) / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 2.5, 5, 10].map((factor) => factor * power).find((each) => each >= raw * 0.999);
  const result = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) {
    result.push(Number((i * step).toPrecision(12)));
  }
  return result;
}

// Texts of evenly spaced values, all with the same number of decimals.
function tickTexts(values) {
  const sizes = values.map(Math.abs).filter((size) => size > 0);
  if (!sizes.length || Math.max(...sizes) >= 1e6 || Math.max(...sizes) < 1e-3) return values.map((value) => numberText(value));
  const decimals = Math.max(...values.map((value) => (String(value).split(".")[1] || "").length));
  return values.map((value) => (decimals > 8 ? numberText(value) : value.toFixed(decimals).replace("-", "−")));
}

// Values of ticks on a logarithmic axis between two logarithms.
function logTicks(low, high, count) {
  const decades = (high - low) / Math.LN10;
  const values = [];
  if (decades < 1.2) return ticks(Math.exp(low), Math.exp(high), count).filter((value) => value > 0);
  const every = Math.ceil(decades / count);
  const first = Math.ceil(low / Math.LN10 - 1e-9);
  for (let power = first; power <= high / Math.LN10 + 1e-9; power++) {
    if ((power - first) % every === 0) values.push(Number(`1e${power}`));
  }
  return values;
}

// Texts of values on a logarithmic axis: all of them powers of ten where one must be.
function logTexts(values) {
  const powers = values.some((value) => value < 1e-3 || value >= 1e6) && values.every((value) => Number.isInteger(Math.log10(value)));
  return values.map((value) => (powers ? `10${raised(Math.log10(value))}` : numberText(value, 4)));
}

const xPixel = (value) => box.left + ((value - state.view[0][0]) / (state.view[0][1] - state.view[0][0])) * box.width;
const yPixel = (value) =>
  box.top + box.height - ((value - state.view[1][0]) / (state.view[1][1] - state.view[1][0])) * box.height;
const xValue = (pixel) => state.view[0][0] + ((pixel - box.left) / box.width) * (state.view[0][1] - state.view[0][0]);
const yValue = (pixel) =>
  state.view[1][1] - ((pixel - box.top) / box.height) * (state.view[1][1] - state.view[1][0]);

function layOut() {
  const frame = byId("frame");
  const width = frame.clientWidth;
  const small = width < 480;
  const bar = !state.variable.flags || state.variable.shaded ? (isLine() ? 0 : small ? 62 : 78) : 0;
  const whole = Math.min(Math.max((small ? 0.9 : 0.74) * (width - bar), 230), Math.max(0.66 * window.innerHeight, 260));
  const height = flat && !isLine() ? 130 : whole;
  frame.style.height = `${height}px`;
  const left = flat && !isLine() ? 14 : small ? 56 : 62;
  box = { left, top: 8, width: width - left - bar - 10, height: height - 8 - 46, right: width };
  return [width, height];
}

function draw() {
  const [width, height] = layOut();
  state.view = state.view || wholeView();
  const context = preparedContext(map, width, height);
  context.clearRect(0, 0, width, height);
  if (data.points) drawPoints(context);
  else if (isLine()) drawLine(context);
  else drawCells(context);
  if (!data.points) drawTheory(context);
  drawAxes(context);
  const scale = state.variable.scale || state.variable.shaded?.scale;
  if (scale && !isLine()) drawBar(context, scale);
  drawMarks();
}

// Packed colours of all cells of the map, and their hatching: 1 slow, 2 undecided, 3 not computed yet.
function cells() {
  const axes = data.map;
  const nx = data.shape[axes[0]];
  const ny = flat ? 1 : data.shape[axes[1]];
  const variable = state.variable;
  const none = packed(colour("empty"));
  const colours = new Uint32Array(nx * ny);
  const hatching = new Uint8Array(nx * ny);
  const paint = coloursOf(variable, none);
  const theory = data.theory;
  const [offset, [dx, dy = 0]] = offsetAndStrides(variable.values, state.index, axes);
  const values = arrays[variable.values.array];
  const shading = variable.shaded && shader(variable, axes);
  const [reasonOffset, [reasonX, reasonY = 0]] = offsetAndStrides(theory.reason, state.index, axes);
  const [slowOffset, [slowX, slowY = 0]] = offsetAndStrides(theory.slow, state.index, axes);
  const reasons = arrays[theory.reason.array];
  const slow = arrays[theory.slow.array];
  const notYet = theory.white.indexOf(theory.hatches.notYet) + 1;
  for (let j = 0; j < ny; j++) {
    for (let i = 0; i < nx; i++) {
      const cell = j * nx + i;
      const value = values[offset + i * dx + j * dy];
      colours[cell] = (shading && shading(value, i, j)) || paint(value);
      const reason = reasons[reasonOffset + i * reasonX + j * reasonY];
      if (notYet && reason === notYet) hatching[cell] = 3;
      else if (variable.flags?.[value]?.hatched) hatching[cell] = 2;
      else if (variable.lines !== "limits" && slow[slowOffset + i * slowX + j * slowY]) hatching[cell] = 1;
    }
  }
  return { nx, ny, colours, hatching };
}

// Function from values of a variable to colours; white stands for what has no value.
function coloursOf(variable, none) {
  if (!variable.flags) {
    const paint = colourMap(variable.scale);
    return (value) => paint(value) || none;
  }
  const colours = variable.flags.map((flag) => (flag.colour === "#ffffff" ? none : packed(flag.colour)));
  return (value) => colours[value] ?? none;
}

// Colours of the cells with one flag by another variable.
function shader(variable, axes) {
  const other = data.variables.find((each) => each.name === variable.shaded.by);
  if (!other) return null;
  const paint = colourMap(variable.shaded.scale);
  const [offset, [dx, dy = 0]] = offsetAndStrides(other.values, state.index, axes);
  const values = arrays[other.values.array];
  return (flag, i, j) => (flag === variable.shaded.flag ? paint(values[offset + i * dx + j * dy]) : 0);
}

function drawCells(context) {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.round(box.width * ratio);
  const height = Math.round(box.height * ratio);
  const image = context.createImageData(width, height);
  const pixels = new Uint32Array(image.data.buffer);
  const { nx, colours, hatching } = cells();
  const xEdges = edges(mapAxis(0));
  const yEdges = flat ? [0, 1] : edges(mapAxis(1));
  const columns = Int32Array.from({ length: width }, (_, i) => cellOf(xEdges, xValue(box.left + (i + 0.5) / ratio)));
  const distance = Math.round(6 * ratio);
  const wide = Math.max(1, Math.round(0.8 * ratio));
  const inks = [0, packed("#262626"), packed("#e6e6e6"), packed("#a6a6a6")];
  for (let row = 0; row < height; row++) {
    const j = cellOf(yEdges, yValue(box.top + (row + 0.5) / ratio));
    if (j < 0) continue;
    for (let column = 0; column < width; column++) {
      const i = columns[column];
      if (i < 0) continue;
      const cell = j * nx + i;
      const hatch = hatching[cell];
      const rising = (column + row) % distance < wide;
      const falling = (column - row + distance * height) % distance < wide;
      const inked = hatch && ((hatch === 1 && rising) || (hatch === 2 && falling) || (hatch === 3 && (rising || falling)));
      pixels[row * width + column] = inked ? inks[hatch] : colours[cell];
    }
  }
  context.putImageData(image, Math.round(box.left * ratio), Math.round(box.top * ratio));
}

function drawClipped(context, drawing) {
  context.save();
  context.beginPath();
  context.rect(box.left, box.top, box.width, box.height);
  context.clip();
  drawing();
  context.restore();
}

const css = (number) => `rgb(${number & 255}, ${(number >> 8) & 255}, ${(number >> 16) & 255})`;

function drawPoints(context) {
  const [x, y] = [mapAxis(0).values, mapAxis(1).values];
  const variable = state.variable;
  const values = arrays[variable.values.array];
  const paint = coloursOf(variable, 0);
  const radius = Math.min(Math.max(0.45 * Math.sqrt((box.width * box.height) / x.length), 1.2), 5);
  const order = x.map((_, i) => i).filter((i) => x[i] !== null && y[i] !== null);
  if (variable.flags) {
    const counts = variable.flags.map(() => 0); // rare flags are drawn above the others
    for (const i of order) counts[at(variable.values, [i])] += 1;
    order.sort((a, b) => counts[at(variable.values, [b])] - counts[at(variable.values, [a])] || a - b);
  }
  drawClipped(context, () => {
    context.lineWidth = 0.5;
    context.strokeStyle = colour("soft");
    for (const i of order) {
      const shade = paint(variable.values.over.length ? values[i] : values[0]);
      context.beginPath();
      context.arc(xPixel(x[i]), yPixel(y[i]), radius, 0, 2 * Math.PI);
      if (shade) {
        context.fillStyle = css(shade);
        context.fill();
      }
      if (radius > 1.5) context.stroke();
    }
  });
}

function drawLine(context) {
  const axis = mapAxis(0);
  const log = state.variable.scale.kind === "log";
  drawClipped(context, () => {
    context.beginPath();
    let pen = false;
    axis.values.forEach((value, i) => {
      const height = at(state.variable.values, [i]);
      const valid = Number.isFinite(height) && (!log || height > 0);
      if (valid) context[pen ? "lineTo" : "moveTo"](xPixel(toDrawing(axis, value)), yPixel(log ? Math.log(height) : height));
      pen = valid;
    });
    context.strokeStyle = colour("accent");
    context.lineWidth = 1.5;
    context.stroke();
  });
}

// Lines of theory that belong to the map shown.
function theoryLines() {
  let number = 0;
  for (const axis of further) number = number * data.shape[axis] + state.index[axis];
  return (data.theory.slices[number] || []).filter((line) => line.on.includes(state.variable.lines));
}

function drawTheory(context) {
  drawClipped(context, () => {
    for (const line of theoryLines()) {
      const style = data.theory.styles[line.kind];
      for (const path of line.paths) tracePath(context, path, style);
    }
  });
}

function tracePath(context, path, style) {
  context.beginPath();
  let pen = false;
  for (const vertex of path) {
    if (vertex.includes(null)) {
      pen = false;
    } else if (vertex.length === 1) {
      const x = xPixel(toDrawing(mapAxis(0), vertex[0]));
      context.moveTo(x, box.top);
      context.lineTo(x, box.top + box.height);
    } else {
      const place = [xPixel(toDrawing(mapAxis(0), vertex[0])), yPixel(toDrawing(mapAxis(1), vertex[1]))];
      context[pen ? "lineTo" : "moveTo"](...place);
      pen = true;
    }
  }
  const width = 1.35 * style.width;
  context.lineWidth = width + 1.6;
  context.setLineDash([]);
  context.strokeStyle = "#ffffff";
  context.stroke();
  context.lineWidth = width;
  context.setLineDash(style.dashes.map((length) => length * width));
  context.strokeStyle = "#000000";
  context.stroke();
  context.setLineDash([]);
}

function drawAxes(context) {
  const ink = colour("ink");
  const soft = colour("soft");
  context.strokeStyle = soft;
  context.lineWidth = 1;
  context.strokeRect(box.left, box.top, box.width, box.height);
  context.font = font(12);
  const x = mapAxis(0);
  const bottom = box.top + box.height;
  context.fillStyle = ink;
  context.textAlign = "center";
  context.textBaseline = "top";
  axisTicks(x, state.view[0], box.width / 85).forEach(([value, text]) => {
    const place = xPixel(toDrawing(x, value));
    context.fillRect(place - 0.5, bottom, 1, 4);
    context.fillText(text, place, bottom + 7);
  });
  drawFormula(context, x.label, box.left + box.width / 2, bottom + 34, 13, ink);
  if (flat && !isLine()) return;
  const y = flat ? { log: state.variable.scale.kind === "log" } : mapAxis(1);
  context.font = font(12);
  context.textAlign = "right";
  context.textBaseline = "middle";
  axisTicks(y, state.view[1], box.height / 60).forEach(([value, text]) => {
    const place = yPixel(toDrawing(y, value));
    context.fillRect(box.left - 4, place - 0.5, 4, 1);
    context.fillText(text, box.left - 7, place);
  });
  const label = flat ? state.variable.label : y.label;
  drawFormula(context, label, 10, box.top + box.height / 2, 13, ink, -Math.PI / 2);
}

// Values and texts of the ticks of an axis.
function axisTicks(axis, [low, high], count) {
  const values = axis.log ? logTicks(low, high, count) : ticks(low, high, count);
  const texts = axis.log ? logTexts(values) : tickTexts(values);
  return values.map((value, i) => [value, texts[i]]);
}

function drawBar(context, scale) {
  const left = box.left + box.width + 12;
  const shades = data.shades[scale.shades];
  shades.forEach((shade, i) => {
    context.fillStyle = `#${shade}`;
    const top = box.top + box.height * (1 - (i + 1) / shades.length);
    context.fillRect(left, top, 12, box.height / shades.length + 0.6);
  });
  const ink = colour("ink");
  context.strokeStyle = colour("soft");
  context.strokeRect(left, box.top, 12, box.height);
  context.fillStyle = ink;
  context.font = font(11);
  context.textAlign = "left";
  context.textBaseline = "middle";
  const log = scale.kind === "log";
  const whole = scale.kind === "integers";
  const [low, high] = whole ? [scale.low - 0.5, scale.high + 0.5] : [scale.low, scale.high];
  const values = log ? logTicks(Math.log(low), Math.log(high), 7) : ticks(low, high, 6);
  const marked = values.filter((each) => !whole || Number.isInteger(each));
  const texts = log ? logTexts(marked) : tickTexts(marked);
  marked.forEach((value, i) => {
    const part = log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
    const place = box.top + box.height * (1 - part);
    context.fillRect(left + 12, place - 0.5, 3, 1);
    context.fillText(texts[i], left + 17, place);
  });
  const other = state.variable.shaded && data.variables.find((each) => each.name === state.variable.shaded.by);
  const label = other ? [{ t: "Lyapunov exponent " }, { t: "λ", i: true }, { t: ` of chaotic points` }] : state.variable.label;
  drawFormula(context, label, box.right - 7, box.top + box.height / 2, 12, ink, -Math.PI / 2);
}

// A ring around the cell or point chosen, a thin frame around the one under the pointer.
function drawMarks() {
  const context = preparedContext(marks, marks.clientWidth, marks.clientHeight);
  context.clearRect(0, 0, marks.clientWidth, marks.clientHeight);
  drawClipped(context, () => {
    for (const [index, strong] of [[state.hovered, false], [state.chosen, true]]) {
      if (!index) continue;
      const [x, y] = pixelOf(index);
      for (const [ink, width] of [["#ffffff", 4], ["#000000", 1.8]]) {
        context.beginPath();
        context.arc(x, y, strong ? 8 : 5, 0, 2 * Math.PI);
        context.lineWidth = strong ? width : 0.6 * width;
        context.strokeStyle = ink;
        context.stroke();
      }
    }
  });
}

// Points.

function pixelOf(index) {
  const x = mapAxis(0);
  if (data.points) return [xPixel(x.values[index[0]]), yPixel(mapAxis(1).values[index[0]])];
  const across = xPixel(toDrawing(x, x.values[index[data.map[0]]]));
  if (!flat) {
    const y = mapAxis(1);
    return [across, yPixel(toDrawing(y, y.values[index[data.map[1]]]))];
  }
  if (!isLine()) return [across, box.top + box.height / 2];
  const height = at(state.variable.values, index);
  return [across, yPixel(state.variable.scale.kind === "log" ? Math.log(height) : height)];
}

// Indices of the cell or the nearest point at a place of the map; null outside.
function indexAt(x, y) {
  const inside = x >= box.left && x <= box.left + box.width && y >= box.top && y <= box.top + box.height;
  if (!inside || !state.view) return null;
  if (data.points) return nearestPoint(x, y);
  const index = state.index.slice();
  const i = cellOf(edges(mapAxis(0)), xValue(x));
  if (i < 0) return null;
  index[data.map[0]] = i;
  if (!flat) {
    const j = cellOf(edges(mapAxis(1)), yValue(y));
    if (j < 0) return null;
    index[data.map[1]] = j;
  }
  return index;
}

function nearestPoint(x, y) {
  const [xs, ys] = [mapAxis(0).values, mapAxis(1).values];
  let best = -1;
  let smallest = 30 ** 2; // pixels
  for (let i = 0; i < xs.length; i++) {
    if (xs[i] === null || ys[i] === null) continue;
    const distance = (xPixel(xs[i]) - x) ** 2 + (yPixel(ys[i]) - y) ** 2;
    if (distance < smallest) [best, smallest] = [i, distance];
  }
  return best < 0 ? null : [best];
}

// Name and value of each axis at a point, as runs.
function coordinateRuns(index) {
  return data.axes.map((axis, number) => {
    const value = axis.values[data.points ? index[0] : index[number]];
    return [...axis.symbol, { t: ` = ${numberText(value)}` }];
  });
}

const coordinateText = (index) =>
  coordinateRuns(index).slice(0, data.points ? 2 : undefined).map(letters).join(", ");

const isSame = (a, b) => a !== null && b !== null && a.every((value, i) => value === b[i]);
