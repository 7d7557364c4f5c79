// Legend of the map, and the values of the point under the pointer or chosen.

// Legend.

function swatch(paint, isLineSample = false) {
  const canvas = element("canvas", { "aria-hidden": "true", class: isLineSample ? "line" : "area" });
  const context = preparedContext(canvas, 26, 13);
  paint(context);
  return canvas;
}

function areaSwatch(shade, hatch) {
  return swatch((context) => {
    context.fillStyle = shade === "#ffffff" ? colour("empty") : shade;
    context.fillRect(0, 0, 26, 13);
    context.strokeStyle = hatch === "slow" ? "#262626" : hatch === "undecided" ? "#e6e6e6" : "#a6a6a6";
    context.lineWidth = 1;
    context.beginPath();
    for (let x = -13; hatch && x < 39; x += 6) {
      if (hatch !== "undecided") { context.moveTo(x, 13); context.lineTo(x + 13, 0); }
      if (hatch !== "slow") { context.moveTo(x, 0); context.lineTo(x + 13, 13); }
    }
    context.stroke();
  });
}

function lineSwatch(style) {
  return swatch((context) => {
    context.strokeStyle = colour("ink");
    context.lineWidth = 1.35 * style.width;
    context.setLineDash(style.dashes.map((length) => length * context.lineWidth));
    context.beginPath();
    context.moveTo(0, 6.5);
    context.lineTo(26, 6.5);
    context.stroke();
  }, true);
}

function entry(sample, text, part) {
  const item = element("li", {}, sample, element("span", {}, text));
  if (part !== undefined) item.append(element("span", { class: "share" }, percent(part)));
  return item;
}

function percent(part) {
  const value = 100 * part;
  return `${value >= 10 && (value < 99.5 || value === 100) ? value.toFixed(0) : value >= 0.1 ? value.toFixed(1) : "< 0.1"} %`;
}

// Indices of all points of the map shown.
function* shownPoints() {
  const index = state.index.slice();
  const [nx, ny] = data.points ? [data.shape[0], 1] : [data.shape[data.map[0]], flat ? 1 : data.shape[data.map[1]]];
  for (let j = 0; j < ny; j++) {
    for (let i = 0; i < nx; i++) {
      index[data.points ? 0 : data.map[0]] = i;
      if (!flat && !data.points) index[data.map[1]] = j;
      yield index;
    }
  }
}

function drawLegend() {
  const legend = byId("legend");
  const variable = state.variable;
  const counts = new Map();
  const reasons = new Map();
  let slow = 0;
  let total = 0;
  for (const index of shownPoints()) {
    total += 1;
    const reason = data.points ? 0 : at(data.theory.reason, index);
    const value = at(variable.values, index);
    if (reason && !["status", "computed"].includes(variable.name)) reasons.set(reason, (reasons.get(reason) || 0) + 1);
    else if (variable.flags) counts.set(value, (counts.get(value) || 0) + 1);
    else if (!Number.isFinite(value)) counts.set("none", (counts.get("none") || 0) + 1);
    if (!data.points && variable.lines !== "limits" && at(data.theory.slow, index)) slow += 1;
  }
  const items = [];
  (variable.flags || []).forEach((flag, value) => {
    if (!counts.has(value)) return;
    items.push(entry(areaSwatch(flag.colour, flag.hatched && "undecided"), flag.text, counts.get(value) / total));
  });
  for (const [reason, count] of reasons) {
    const text = data.theory.white[reason - 1];
    items.push(entry(areaSwatch("#ffffff", text === data.theory.hatches.notYet && "notYet"), text, count / total));
  }
  if (counts.has("none")) items.push(entry(areaSwatch("#ffffff"), "no value", counts.get("none") / total));
  if (slow) items.push(entry(areaSwatch("#ffffff", "slow"), data.theory.slowText, slow / total));
  for (const kind of new Set(theoryLines().map((line) => line.kind))) {
    items.push(entry(lineSwatch(data.theory.styles[kind]), formula(data.theory.styles[kind].text)));
  }
  legend.replaceChildren(...items);
  marks.setAttribute("aria-label", `Map of ${variable.plain} over ${state.axes.map((k) => data.axes[k].plain).join(" and ")}`);
}

// Values of a point.

const FIRST_FLAGS = ["label", "label_inertial"];

// A table of names and values; returns the table and a function that fills it for a point.
function valueTable(rows, caption) {
  const cells = rows.map((row) => element("td"));
  const body = rows.map((row, i) => {
    const head = element("th", { scope: "row", title: row.title || "" }, formula(row.label));
    return element("tr", {}, head, cells[i]);
  });
  const table = element("table", { "aria-label": caption }, element("tbody", {}, ...body));
  const fill = (index) => rows.forEach((row, i) => cells[i].replaceChildren(...row.value(index)));
  return [table, fill];
}

function variableRow(variable) {
  const value = (index) => {
    const number = at(variable.values, index);
    if (!variable.flags) return [numberText(number)];
    const flag = variable.flags[number];
    return [flag ? flag.text : String(number)];
  };
  const comment = variable.comment ? `; ${variable.comment}` : "";
  return { label: variable.label, title: `${variable.name}: ${variable.text}${comment}`, value };
}

const fillers = [];

function addTable(parent, caption, rows, isOpen = true) {
  if (!rows.length) return;
  const [table, fill] = valueTable(rows, caption);
  fillers.push(fill);
  if (isOpen) {
    parent.append(element("section", {}, element("h3", {}, caption), table));
  } else {
    parent.append(element("details", {}, element("summary", {}, caption), table));
  }
}

function buildValues() {
  const values = byId("values");
  const columns = element("div", { class: "columns" });
  const of = (group) => data.variables.filter((each) => each.group === group && !FIRST_FLAGS.includes(each.name));
  const parameters = (data.motion.parameters || []).map((parameter) => ({
    label: [...parameter.symbol, ...(parameter.unit.length ? [{ t: " (" }, ...parameter.unit, { t: ")" }] : [])],
    title: `${parameter.name}: ${parameter.text}`,
    value: (index) => [numberText(at(parameter.values, index), 8)],
    varies: parameter.values.over.length > 0,
  }));
  const first = element("div");
  const second = element("div");
  columns.append(first, second);
  addTable(first, "Theory", of("theory").map(variableRow));
  addTable(first, "Parameters that vary", parameters.filter((row) => row.varies));
  addTable(second, "Measured", of("motion").map(variableRow));
  addTable(second, "Numerics", of("numerics").map(variableRow));
  values.append(columns);
  addTable(values, "Parameters that are the same everywhere", parameters.filter((row) => !row.varies), false);
}

// Label, its meaning, and status in words.
function verdict(index) {
  const nodes = [];
  for (const name of FIRST_FLAGS) {
    const variable = data.variables.find((each) => each.name === name);
    const flag = variable?.flags?.[at(variable.values, index)];
    if (!flag) continue;
    const dot = element("i");
    dot.style.background = flag.colour;
    const frame = name === "label" ? data.frame : "inertial";
    const text = frame ? `${flag.text} (${frame} frame)` : flag.text;
    nodes.push(element("div", { class: "badge" }, dot, text));
    nodes.push(element("p", { class: "sentence" }, flag.sentence));
  }
  const status = data.variables.find((each) => each.name === "status");
  const flag = status?.flags?.[at(status.values, index)];
  if (flag && flag.name !== "ok") {
    nodes.push(element("p", { class: "sentence warning" }, `Status: ${flag.text}: ${flag.sentence}.`));
  } else if (flag) {
    nodes.push(element("p", { class: "sentence" }, `Status: ${flag.sentence}.`));
  }
  const estimate = data.variables.find((each) => each.name === "error_estimate");
  if (estimate && at(estimate.values, index) > 1) {
    const stable = data.variables.find((each) => each.name === "stable");
    const unstable = stable?.flags?.[at(stable.values, index)]?.name === "unstable";
    const words = unstable
      ? "an instability has amplified errors until the final state is unknown"
      : "the final state or a statistic, such as psi' of an axis that passes through the vertical, is unknown";
    nodes.push(element("p", { class: "sentence" }, `Error estimate above 1: ${words}; the label has checks of its own.`));
  }
  const reason = data.motion.reason ? at(data.motion.reason, index) : 0;
  if (reason && data.motion.sentences[reason]) {
    nodes.push(element("p", { class: "sentence warning" }, `No motion: ${data.motion.sentences[reason]}.`));
  }
  return nodes;
}

// Names and values of the axes at a point.
function coordinateNodes(index) {
  return coordinateRuns(index).slice(0, data.points ? 4 : undefined).flatMap((runs, i) => (i ? [", ", formula(runs)] : [formula(runs)]));
}

// Show the values of a point, or those of the one chosen.
function showPoint(index) {
  const point = index || state.chosen;
  const heading = byId("place");
  byId("values").hidden = !point;
  byId("point-section").classList.toggle("empty", !point);
  if (!point) {
    heading.replaceChildren("Point at the map");
    byId("verdict").replaceChildren(element("p", { class: "sentence" }, "The values of the point appear here, and after a click its motion."));
    return;
  }
  heading.replaceChildren(...coordinateNodes(point));
  byId("verdict").replaceChildren(...verdict(point));
  for (const fill of fillers) fill(point);
}

// Sentence about a point for screen readers.
function announce(index) {
  const variable = state.variable;
  const value = at(variable.values, index);
  const text = variable.flags ? variable.flags[value]?.text ?? value : `${variable.plain} ${numberText(value)}`;
  byId("announcement").textContent = `${coordinateText(index)}: ${text}`;
}
