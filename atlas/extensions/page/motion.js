// The motion of a point, integrated with the method and the steps of `atlas.trajectory`, and its pictures.

const PATH_POINTS = 20000; // at most so many are drawn
const SLICE = 25; // ms of computing before the page may react
const SMALL = 0.1; // rad; paths that stay within it are drawn enlarged, too
const AT_REST = 1e-12;
let current = 0; // number of the motion chosen last
const view3d = { azimuth: (40 * Math.PI) / 180, elevation: (25 * Math.PI) / 180 };

// Numbers that a point is integrated from.
function startOf(index) {
  const motion = data.motion;
  return {
    state: motion.state.map((row) => at(row, index)),
    constants: motion.constants.map((row) => at(row, index)),
    duration: at(motion.duration, index),
    steps: at(motion.steps, index), // from one sample to the next
    stepSize: at(motion.duration, index) / (at(motion.steps, index) * (motion.samples - 1)),
  };
}

// States at evenly spaced samples. Between two samples the kernel computes in units of the step, as in Python;
// `record` gets some states between them as well. `pause` resolves to false where another motion has been chosen.
async function integrate(start, samples, record, pause) {
  const unit = start.stepSize / data.motion.stepUnit;
  const parts = recordsPerSample(start.steps, samples);
  const every = start.steps / parts;
  let state = start.state;
  record(state);
  let started = performance.now();
  for (let sample = 1; sample < samples; sample++) {
    const [scaled, constants] = equations.scaled(state, start.constants, unit);
    let y = scaled;
    for (let k = 1; k <= start.steps; k++) {
      y = equations.step(y, equations.rhs(y, constants), constants);
      if (k % every === 0 && k < start.steps) record(equations.unscaled(y, constants, unit));
      if (k % 256 === 0 && performance.now() - started > SLICE) {
        if (!(await pause((sample - 1 + k / start.steps) / (samples - 1)))) return null;
        started = performance.now();
      }
    }
    state = equations.unscaled(y, constants, unit);
    record(state);
  }
  return state;
}

// Into how many parts the distance of two samples is divided for the picture: a divisor of the steps.
function recordsPerSample(steps, samples) {
  let parts = Math.max(1, Math.floor(PATH_POINTS / (samples - 1)));
  while (steps % parts !== 0) parts -= 1;
  return parts;
}

// The motion of a point as columns over time; null where another one has been chosen meanwhile.
async function motionOf(index, pause = async () => true) {
  const start = startOf(index);
  const samples = data.motion.samples;
  const states = [];
  const end = await integrate(start, samples, (state) => states.push(state), pause);
  if (end === null) return null;
  const last = states.length - 1;
  const time = states.map((_, i) => (start.duration * i) / last);
  const result = { start, time, states, perSample: last / (samples - 1) };
  if (!data.motion.observables.length) return { ...result, ...observed(states, start, time) };
  const series = data.motion.observables.map(({ name, label, state }) => {
    const value = (y) => (state === null ? equations[name](y, start.constants) : y[state]);
    return { label, values: states.map(value) };
  });
  return { ...result, series };
}

// theta, psi' and the path of the third body axis; psi' has no value on the vertical.
function observed(states, start, time) {
  const motions = states.map((state) => equations.frame_motion(state, start.constants));
  const theta = motions.map(([, , , g1, g2, g3]) => Math.atan2(Math.hypot(g1, g2), g3));
  const psiDot = motions.map(([u1, u2, , g1, g2]) => (u1 * g1 + u2 * g2) / (g1 * g1 + g2 * g2));
  const path = motions.map((each, i) => [...equations.axis_in_frame(states[i], start.constants), each[5]]);
  return { theta, psiDot, path };
}

// Integrate the point chosen and show its motion.
async function showMotion(index) {
  const number = ++current;
  const section = byId("motion-section");
  const progress = byId("motion-state");
  section.hidden = false;
  section.dataset.done = "";
  byId("plots").replaceChildren();
  byId("reproduce").replaceChildren();
  byId("motion-place").replaceChildren(...coordinateNodes(index));
  lastMotion = null;
  if (!equations || data.motion.fault) {
    progress.textContent = data.motion.fault;
    showCommands(index);
    return;
  }
  const reason = at(data.motion.reason, index);
  if (reason || !Number.isFinite(at(data.motion.duration, index))) {
    progress.textContent = `No motion: ${data.motion.sentences[reason] || "no start or no duration"}`;
    return;
  }
  const pause = async (share) => {
    progress.textContent = `integrating, ${Math.round(100 * share)} %`;
    await new Promise((resolve) => setTimeout(resolve));
    return number === current;
  };
  const motion = await motionOf(index, pause);
  if (motion === null) return;
  const { start } = motion;
  const count = start.steps * (data.motion.samples - 1);
  progress.textContent = `${numberText(start.duration)} time units, ${data.motion.method}, ${count} steps of ${numberText(start.stepSize, 4)}`;
  const bad = motion.states.findIndex((state) => !state.every(Number.isFinite));
  if (bad >= 0) progress.textContent += `; not finite from t = ${numberText(motion.time[bad])}`;
  drawMotion(motion);
  showCommands(index);
  section.dataset.done = index.join(",");
}

// Pictures.

let lastMotion = null;

function drawMotion(motion) {
  lastMotion = motion;
  const plots = byId("plots");
  plots.replaceChildren();
  if (motion.series) {
    for (const { label, values } of motion.series) drawSeries(plots, motion.time, values, label);
    return;
  }
  const stack = element("div", { class: "stack" });
  const side = element("div", { class: "stack" });
  plots.append(stack, side);
  const unit = [{ t: " (rad s" }, { t: "−1", s: 1 }, { t: ")" }];
  const { angle } = data.motion;
  drawSeries(stack, motion.time, motion.theta.map((each) => each * angle.factor), [{ t: "θ", i: true }, { t: ` (${angle.unit})` }]);
  drawSeries(stack, motion.time, motion.psiDot, [{ t: "ψ̇", i: true }, ...unit], true);
  addSphere(side, motion.path);
  addEnlarged(side, motion.path);
}

// Ends of a plot: all values, or where a few are far beyond the others, a multiple of most of them.
function plotRange(values, clip) {
  const finite = values.filter(Number.isFinite);
  if (!finite.length) return null;
  let low = finite.reduce((a, b) => Math.min(a, b));
  let high = finite.reduce((a, b) => Math.max(a, b));
  if (clip) {
    const sizes = Float64Array.from(finite, Math.abs).sort();
    const most = sizes[Math.floor(0.9 * (sizes.length - 1))];
    if (sizes.at(-1) > 10 * most && most > 0) [low, high] = [Math.max(low, -3 * most), Math.min(high, 3 * most)];
  }
  return [low, high];
}

// A range as words: "0.4 to 0.6", or the value where it does not change but for rounding.
function rangeText([low, high]) {
  const size = Math.max(Math.abs(low), Math.abs(high));
  const span = high - low;
  if (span <= 1e-13 * Math.max(size, 1)) return `${numberText(low, 8)}, constant within ${numberText(Math.max(span, 1e-16), 1)}`;
  const digits = Math.min(15, Math.max(4, Math.ceil(Math.log10(size / span)) + 3));
  return `from ${numberText(low, digits)} to ${numberText(high, digits)}`;
}

function drawSeries(parent, time, values, label, clip = false) {
  const canvas = element("canvas", { role: "img" });
  const caption = element("figcaption", {}, formula(label));
  parent.append(element("figure", {}, caption, canvas));
  const range = plotRange(values, clip);
  if (!range) {
    caption.append(": no value");
    canvas.remove();
    return;
  }
  const whole = plotRange(values, false);
  const words = rangeText(whole) + (whole[0] < range[0] || whole[1] > range[1] ? ", cut in the picture" : "");
  caption.append(" ", words);
  canvas.setAttribute("aria-label", `${letters(label)} over time, ${words}`);
  const [width, height] = [canvas.clientWidth || 300, 138];
  canvas.style.height = `${height}px`;
  const context = preparedContext(canvas, width, height);
  const frame = { left: 54, top: 16, width: width - 62, height: height - 40 };
  const { low, high, offset } = plotScale(range);
  const x = (value) => frame.left + (value / time.at(-1)) * frame.width;
  const y = (value) => frame.top + frame.height * (1 - (value - offset - low) / (high - low));
  drawFrame(context, frame, time, low, high, offset);
  context.beginPath();
  context.rect(frame.left, frame.top, frame.width, frame.height);
  context.clip();
  context.beginPath();
  let pen = false;
  values.forEach((value, i) => {
    if (Number.isFinite(value)) context[pen ? "lineTo" : "moveTo"](x(time[i]), y(value));
    pen = Number.isFinite(value);
  });
  context.strokeStyle = colour("accent");
  context.lineWidth = 1.3;
  context.lineJoin = "round";
  context.stroke();
}

// Ends of the vertical axis; small changes are drawn relative to a round number, the offset.
function plotScale([low, high]) {
  const middle = 0.5 * (low + high);
  const span = high - low;
  if (span <= 1e-13 * Math.max(Math.abs(middle), 1)) {
    const half = 0.5 * Math.max(Math.abs(middle), 1e-3);
    return { low: middle - half, high: middle + half, offset: 0 };
  }
  const digits = Math.ceil(Math.log10(Math.abs(middle) / span));
  const offset = digits >= 3 ? Number(middle.toPrecision(Math.min(digits + 1, 16))) : 0;
  return { low: low - offset - 0.06 * span, high: high - offset + 0.06 * span, offset };
}

function drawFrame(context, frame, time, low, high, offset) {
  const ink = colour("ink");
  context.strokeStyle = colour("line");
  context.fillStyle = ink;
  context.lineWidth = 1;
  context.font = font(11);
  const bottom = frame.top + frame.height;
  const vertical = ticks(low, high, 4);
  const exponent = Math.floor(Math.log10(Math.max(Math.abs(low), Math.abs(high))));
  const factor = exponent < -3 || exponent > 4 ? exponent : 0;
  context.textAlign = "right";
  context.textBaseline = "middle";
  const texts = tickTexts(vertical.map((value) => value / 10 ** factor));
  vertical.forEach((value, i) => {
    const y = bottom - ((value - low) / (high - low)) * frame.height;
    context.beginPath();
    context.moveTo(frame.left, y);
    context.lineTo(frame.left + frame.width, y);
    context.stroke();
    context.fillText(texts[i], frame.left - 5, y);
  });
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const value of ticks(0, time.at(-1), frame.width / 70)) {
    const x = frame.left + (value / time.at(-1)) * frame.width;
    context.fillRect(x - 0.5, bottom, 1, 3);
    if (x < frame.left + frame.width - 22) context.fillText(numberText(value), x, bottom + 5);
  }
  context.textAlign = "right";
  context.fillText("time", frame.left + frame.width, bottom + 5);
  context.strokeRect(frame.left, frame.top, frame.width, frame.height);
  const notes = [];
  if (factor) notes.push(`× 10${raised(factor)}`);
  if (offset) notes.push(`${offset > 0 ? "+" : "−"} ${numberText(Math.abs(offset), 16)}`);
  context.textAlign = "left";
  context.textBaseline = "bottom";
  context.fillStyle = colour("soft");
  if (notes.length) context.fillText(notes.join(" "), frame.left, frame.top - 2);
}

// The sphere: a path of the third axis, seen from a direction that the reader turns.
function addSphere(parent, path) {
  const canvas = element("canvas", {
    role: "img", tabindex: "0", class: "turn",
    "aria-label": "Path of the third body axis on the unit sphere; drag, or use the arrow keys, to turn it",
  });
  const play = element("button", { type: "button", class: "play" });
  parent.append(element("figure", {}, element("figcaption", {}, "third body axis; drag to turn ", play), canvas));
  const radius = Math.min((canvas.clientWidth / 2 - sideLabels(canvas)) / 1.13, 130);
  canvas.style.height = `${Math.round(2.56 * radius)}px`;
  let place = 0;
  const redraw = () => drawSphere(canvas, path, radius, place);
  addPlayer(play, canvas, (share) => {
    place = Math.round(share * (path.length - 1));
    redraw();
  });
  const turn = (dx, dy) => {
    view3d.azimuth -= dx;
    view3d.elevation = Math.min(Math.max(view3d.elevation + dy, -Math.PI / 2), Math.PI / 2);
    redraw();
  };
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons) turn(event.movementX * 0.01, event.movementY * 0.01);
  });
  canvas.addEventListener("keydown", (event) => {
    const moves = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    if (!moves[event.key]) return;
    event.preventDefault();
    turn(...moves[event.key]);
  });
  redraw();
}

// A button that lets time run once from start to end, and stops it; show: draws the motion at a share of its duration.
const PLAY_SECONDS = 12;

function addPlayer(button, canvas, show) {
  let from = 0; // share at which the time runs on
  let started = null;
  const label = (text, words) => {
    button.textContent = text;
    button.setAttribute("aria-label", words);
  };
  const step = (now) => {
    if (started === null || !canvas.isConnected) return;
    // The time of a frame may be a little before that of the click.
    const share = Math.min(from + Math.max(now - started, 0) / (1000 * PLAY_SECONDS), 1);
    show(share);
    if (share < 1) requestAnimationFrame(step);
    else stop(0);
  };
  const stop = (share) => {
    from = share;
    started = null;
    label("▶ play", "Play the motion");
  };
  button.addEventListener("click", () => {
    if (started !== null) {
      stop(Math.min(from + (performance.now() - started) / (1000 * PLAY_SECONDS), 1));
      return;
    }
    started = performance.now();
    label("❚❚ pause", "Pause the motion");
    requestAnimationFrame(step);
  });
  stop(0);
}

// Width that the longer name of the two horizontal directions needs beside the sphere.
function sideLabels(canvas) {
  const context = canvas.getContext("2d");
  context.font = font(12);
  return 6 + Math.max(...data.motion.frameAxes.slice(0, 2).map((name) => context.measureText(letters(name)).width));
}

function drawSphere(canvas, path, radius, place) {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const context = preparedContext(canvas, width, height);
  const { azimuth, elevation } = view3d;
  const viewer = [Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation)];
  const right = [-Math.sin(azimuth), Math.cos(azimuth), 0];
  const up = [-Math.sin(elevation) * Math.cos(azimuth), -Math.sin(elevation) * Math.sin(azimuth), Math.cos(elevation)];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const project = (point) => [width / 2 + radius * dot(point, right), height / 2 - radius * dot(point, up)];
  const trace = (points, near, far, thick) => {
    for (const [isNear, ink] of [[false, far], [true, near]]) {
      context.beginPath();
      let pen = false;
      for (const point of points) {
        const isVisible = dot(point, viewer) >= 0 === isNear && point.every(Number.isFinite);
        if (isVisible) context[pen ? "lineTo" : "moveTo"](...project(point));
        pen = isVisible;
      }
      context.strokeStyle = ink;
      context.lineWidth = thick;
      context.stroke();
    }
  };
  context.strokeStyle = colour("soft");
  context.beginPath();
  context.arc(width / 2, height / 2, radius, 0, 2 * Math.PI);
  context.stroke();
  const circle = Array.from({ length: 91 }, (_, i) => (i * Math.PI) / 45);
  for (const latitude of [-60, -30, 0, 30, 60].map((degrees) => (degrees * Math.PI) / 180)) {
    const ring = circle.map((a) => [Math.cos(latitude) * Math.cos(a), Math.cos(latitude) * Math.sin(a), Math.sin(latitude)]);
    trace(ring, colour("soft"), colour("line"), latitude === 0 ? 0.9 : 0.5);
  }
  drawDirections(context, project, radius, width, height);
  context.lineJoin = "round";
  trace(path, colour("accent"), colour("far"), 1.6);
  const [x, y] = project(path[place]);
  context.strokeStyle = context.fillStyle = colour("second");
  if (place) { // the axis itself, from the fixed centre
    context.beginPath();
    context.moveTo(width / 2, height / 2);
    context.lineTo(x, y);
    context.stroke();
  }
  context.beginPath();
  context.arc(x, y, 3.6, 0, 2 * Math.PI);
  context.fill();
}

function drawDirections(context, project, radius, width, height) {
  const ink = colour("ink");
  [[1, 0, 0], [0, 1, 0], [0, 0, 1]].forEach((direction, i) => {
    const tip = project(direction);
    const away = [tip[0] - width / 2, tip[1] - height / 2];
    const length = Math.hypot(...away) || 1;
    const outside = away.map((part) => part / length);
    context.strokeStyle = ink;
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(...tip);
    context.lineTo(width / 2 + 1.08 * radius * outside[0], height / 2 + 1.08 * radius * outside[1]);
    context.stroke();
    const align = outside[0] > 0.3 ? 0 : outside[0] < -0.3 ? 1 : 0.5;
    const place = [width / 2 + 1.13 * radius * outside[0], height / 2 + 1.17 * radius * outside[1]];
    drawFormula(context, data.motion.frameAxes[i], ...place, 12, ink, 0, align);
  });
}

// A path that stays near a direction, in the plane perpendicular to it; see plotting/trajectory.py.
function addEnlarged(parent, path) {
  const finite = path.filter((point) => point.every(Number.isFinite));
  const sum = finite.reduce((a, b) => a.map((value, i) => value + b[i]), [0, 0, 0]);
  const length = Math.hypot(...sum) || 1;
  const mean = sum.map((value) => value / length);
  const away = finite.map((point) => point.map((value, i) => value - mean[i]));
  const distance = away.reduce((most, each) => Math.max(most, Math.hypot(...each)), 0);
  if (distance >= SMALL) return;
  if (distance <= AT_REST) {
    parent.append(element("p", { class: "sentence" }, `At rest within ${numberText(Math.max(distance, 1e-16), 1)} rad.`));
    return;
  }
  const sine = Math.hypot(mean[0], mean[1]);
  const first = sine < SMALL ? [1, 0, 0] : [-mean[1] / sine, mean[0] / sine, 0];
  const second = sine < SMALL ? [0, 1, 0] : [
    mean[1] * first[2] - mean[2] * first[1], mean[2] * first[0] - mean[0] * first[2], mean[0] * first[1] - mean[1] * first[0],
  ];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const points = away.map((each) => [dot(each, first), dot(each, second)]);
  const canvas = element("canvas", { role: "img", "aria-label": `The same, enlarged: within ${numberText(distance, 2)} rad of its mean` });
  const caption = element("figcaption", {}, `the same, enlarged: within ${numberText(distance, 2)} rad`);
  parent.append(element("figure", {}, caption, canvas));
  drawEnlarged(canvas, points);
}

function drawEnlarged(canvas, points) {
  const size = Math.min(canvas.clientWidth || 200, 170);
  canvas.style.height = `${size}px`;
  const width = canvas.clientWidth || size;
  const context = preparedContext(canvas, width, size);
  const range = (k) => [points.reduce((a, p) => Math.min(a, p[k]), Infinity), points.reduce((a, p) => Math.max(a, p[k]), -Infinity)];
  const [x, y] = [range(0), range(1)];
  const scale = (0.84 * size) / Math.max(x[1] - x[0], y[1] - y[0]);
  const place = (p) => [width / 2 + scale * (p[0] - 0.5 * (x[0] + x[1])), size / 2 - scale * (p[1] - 0.5 * (y[0] + y[1]))];
  context.strokeStyle = colour("line");
  context.strokeRect((width - size) / 2 + 0.5, 0.5, size - 1, size - 1);
  context.beginPath();
  points.forEach((point, i) => context[i ? "lineTo" : "moveTo"](...place(point)));
  context.strokeStyle = colour("accent");
  context.lineWidth = 1;
  context.stroke();
  context.fillStyle = colour("second");
  context.beginPath();
  context.arc(...place(points[0]), 3.2, 0, 2 * Math.PI);
  context.fill();
}

// Lines to copy.

// Name, dimension and value of each coordinate of a point, with all digits.
function coordinatesOf(index) {
  return data.commands.places.map((each) => ({ ...each, value: at(each.values, index) })).filter(({ value }) => !Number.isNaN(value));
}

function showCommands(index) {
  const { shell, python } = data.commands;
  const coordinates = coordinatesOf(index);
  if (!coordinates.length) return;
  const command = `${shell} ${coordinates.map(({ name, value }) => `${name}=${value}`).join(" ")}`;
  const line = `${python}(${coordinates.map(({ dim, value }) => `${dim}=${value}`).join(", ")})`;
  const rows = [[command, "Copy the command"], [line, "Copy the Python line"]].map(([text, label]) => {
    const code = element("code", {}, text);
    const button = element("button", { type: "button", "aria-label": label }, "Copy");
    button.addEventListener("click", () => copy(code, button));
    return element("div", { class: "copy" }, code, button);
  });
  byId("reproduce").replaceChildren(element("h3", {}, "The same from the shell and from Python"), ...rows);
}

async function copy(code, button) {
  try {
    await navigator.clipboard.writeText(code.textContent);
    button.textContent = "Copied";
  } catch {
    getSelection().selectAllChildren(code); // the reader presses the keys to copy
    button.textContent = "Selected";
  }
  setTimeout(() => { button.textContent = "Copy"; }, 1500);
}
