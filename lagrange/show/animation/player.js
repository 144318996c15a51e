// Draws the frames of `sheet` on the canvas and plays them. Lengths are pixels of the sheet; y grows downwards.

const canvas = document.getElementById("picture");
const pen = canvas.getContext("2d");
const control = name => document.getElementById(name);
const PLAY = "M5 3l12 7-12 7z", PAUSE = "M5 3h4v14H5zM11 3h4v14h-4z";
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
const [PAPER, QUIET, GRID] = [0, 2, 3];
const [WIDTH, HEIGHT] = sheet.size;
const u = sheet.unit, detail = sheet.detail, frames = sheet.frames;
const unpack = text => {
  const bytes = Uint8Array.from(atob(text), mark => mark.charCodeAt(0));
  return new Int16Array(bytes.buffer);
};
const packed = unpack(sheet.numbers);
const samples = (frames - 1) * detail + 1;
const at = (row, k) => packed[row * samples + k] * sheet.grain;
const x = (track, k) => at(2 * track, k), y = (track, k) => at(2 * track + 1, k);
const dark = matchMedia("(prefers-color-scheme: dark)");
let colours = [];
let still = null, clear = null; // fixed parts: with pale curves over time, and with the curves up to now
let shown = 0, playing = false, speed = 1, looping = true, began = 0, visible = true, pending = false;

function line(target, points, colour, width, opacity = 1) {
  target.globalAlpha = opacity;
  target.strokeStyle = colours[colour];
  target.lineWidth = width;
  target.beginPath();
  for (let i = 0; i < points.length; i += 2) target.lineTo(points[i], points[i + 1]);
  target.stroke();
  target.globalAlpha = 1;
}

function words(target, [text, left, base, size, anchor, colour, bold]) {
  target.fillStyle = colours[colour];
  target.font = (bold ? "600 " : "") + size + "px system-ui, sans-serif";
  target.textAlign = anchor === "middle" ? "center" : anchor;
  target.fillText(text, left, base);
}

function dot(left, top, colour, radius, square) {
  pen.beginPath();
  if (square) pen.rect(left - radius, top - radius, 2 * radius, 2 * radius);
  else pen.arc(left, top, radius, 0, 7);
  pen.fillStyle = colours[colour];
  pen.fill();
  pen.lineWidth = u;
  pen.strokeStyle = colours[PAPER];
  pen.stroke();
}

function trail(track, colour, k) {
  pen.lineCap = "butt";
  for (let part = 0; part < sheet.fades; part++) {
    const from = Math.max(0, Math.round(k - sheet.tail + part * sheet.tail / sheet.fades));
    const to = Math.round(k - sheet.tail + (part + 1) * sheet.tail / sheet.fades);
    const points = [];
    for (let i = from; i <= to; i++) points.push(x(track, i), y(track, i));
    if (points.length > 2) line(pen, points, colour, sheet.widths.trail * u, (part + 1) / sheet.fades * sheet.newest);
  }
  pen.lineCap = "round";
}

function joint(start, end, spring, k) {
  const x0 = x(start, k), y0 = y(start, k), along = x(end, k) - x0, down = y(end, k) - y0;
  if (!spring) return line(pen, [x0, y0, x0 + along, y0 + down], QUIET, sheet.widths.rod * u);
  const length = Math.hypot(along, down) || 1, wide = sheet.widths.spring * u / length, points = [];
  for (let i = 0; i < sheet.spring.length; i += 2) {
    const share = sheet.spring[i], aside = sheet.spring[i + 1] * wide;
    points.push(x0 + along * share - down * aside, y0 + down * share + along * aside);
  }
  line(pen, points, QUIET, sheet.widths.wire * u);
}

function chart({rows, colours: own, box: [, top, , bottom], first, last}, k) {
  const place = i => samples > 1 ? first + (last - first) * i / (samples - 1) : first;
  const left = Math.min(first, place(k)), wide = Math.abs(place(k) - first), high = bottom - top + 4 * u;
  const [across, down] = [canvas.width / WIDTH, canvas.height / HEIGHT];
  if (wide > 0) {
    const part = [left * across, (top - 2 * u) * down, wide * across, high * down];
    pen.drawImage(clear, ...part, left, top - 2 * u, wide, high);
  }
  line(pen, [place(k), top, place(k), bottom], QUIET, u);
  rows.forEach((row, i) => dot(place(k), at(row, k), own[i], 3.2 * u));
}

const time = frame => sheet.span[0] + (sheet.span[1] - sheet.span[0]) * (frame / Math.max(1, frames - 1));
function clock(frame) {
  let text = time(frame).toFixed(sheet.decimals);
  if (Number(text) === 0) text = text.replace("-", "");
  return "t = " + text.replace("-", "\u2212") + sheet.timeUnit;
}

function background(width, opacity) {
  const made = document.createElement("canvas");
  made.width = canvas.width;
  made.height = canvas.height;
  const target = made.getContext("2d");
  target.scale(canvas.width / WIDTH, canvas.height / HEIGHT);
  target.fillStyle = colours[PAPER];
  target.fillRect(0, 0, WIDTH, HEIGHT);
  target.lineCap = target.lineJoin = "round";
  for (const stroke of sheet.strokes) line(target, ...stroke);
  for (const {rows, colours: own, first, last} of sheet.charts) rows.forEach((row, i) => {
    const points = [];
    for (let j = 0; j < samples; j++) points.push(first + (last - first) * j / Math.max(1, samples - 1), at(row, j));
    line(target, points, own[i], width * u, opacity);
  });
  for (const text of sheet.words) words(target, text);
  return made;
}

function draw() {
  pending = false;
  const k = shown * detail;
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.drawImage(still, 0, 0);
  pen.setTransform(canvas.width / WIDTH, 0, 0, canvas.height / HEIGHT, 0, 0);
  pen.lineCap = pen.lineJoin = "round";
  for (const [point, below] of sheet.shadows) {
    line(pen, [x(point, k), y(point, k), x(below, k), y(below, k)], GRID, u);
    dot(x(below, k), y(below, k), QUIET, sheet.widths.shadow * u);
  }
  for (const [track, colour] of sheet.trails) trail(track, colour, k);
  for (const [start, end, spring] of sheet.joints) joint(start, end, spring, k);
  for (const [track, colour, fixed] of sheet.marks)
    dot(x(track, k), y(track, k), colour, (fixed ? 0.6 : 1) * sheet.widths.mark * u, fixed);
  for (const one of sheet.charts) chart(one, k);
  const [, left, base, size, anchor, colour] = sheet.clock;
  words(pen, [clock(shown), left, base, size, anchor, colour, false]);
  const seek = control("seek");
  seek.value = shown;
  seek.setAttribute("aria-valuetext", clock(shown));
}

function resize() {
  const wide = Math.max(1, Math.round(canvas.clientWidth * (devicePixelRatio || 1)));
  canvas.width = wide;
  canvas.height = Math.round(wide * HEIGHT / WIDTH);
  colours = sheet.palettes[sheet.style === "auto" ? (dark.matches ? "dark" : "light") : sheet.style];
  still = background(sheet.widths.thin, sheet.faint);
  clear = background(sheet.widths.curve, 1);
  draw();
}

function show(frame) {
  shown = Math.min(frames - 1, Math.max(0, frame));
  if (!pending) { pending = true; requestAnimationFrame(draw); }
}

function tick(now) {
  if (!playing || !visible) return;
  let frame = Math.floor((now - began) / 1000 * speed / sheet.interval + 1e-6);
  if (frame >= frames) {
    if (!looping) { show(frames - 1); return play(false); }
    frame %= frames;
    began = now - frame * sheet.interval * 1000 / speed;
  }
  if (frame !== shown && frame >= 0) { shown = frame; draw(); }
  requestAnimationFrame(tick);
}

function resume() {
  began = performance.now() - shown * sheet.interval * 1000 / speed;
  requestAnimationFrame(tick);
}

function play(wanted) {
  playing = wanted && frames > 1;
  const button = control("play");
  button.setAttribute("aria-label", playing ? "Pause" : "Play");
  button.querySelector("path").setAttribute("d", playing ? PAUSE : PLAY);
  if (!playing) return;
  if (shown >= frames - 1) shown = 0;
  resume();
}

function stepTo(frame) { play(false); show(frame); }

function setSpeed(value) {
  speed = value;
  control("speed").value = String(value);
  if (playing) resume();
}

function setLoop(wanted) {
  looping = wanted;
  control("loop").setAttribute("aria-pressed", String(wanted));
  control("loop").style.opacity = wanted ? 1 : 0.4;
}

function faster(by) {
  const place = SPEEDS.indexOf(speed) + by;
  if (SPEEDS[place]) setSpeed(SPEEDS[place]);
}

const KEYS = {
  " ": () => play(!playing),
  k: () => play(!playing),
  ArrowLeft: () => stepTo(shown - 1),
  ArrowRight: () => stepTo(shown + 1),
  PageUp: () => show(shown - Math.round(1 / sheet.interval)),
  PageDown: () => show(shown + Math.round(1 / sheet.interval)),
  Home: () => show(0),
  End: () => stepTo(frames - 1),
  "+": () => faster(1),
  "-": () => faster(-1),
  l: () => setLoop(!looping),
};

function pressed(event) {
  const own = event.target.tagName;
  if (event.ctrlKey || event.metaKey || event.altKey || own === "SELECT") return;
  if (own === "BUTTON" && event.key === " ") return;
  const act = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!act) return;
  event.preventDefault();
  act();
  if (playing) resume();
}

SPEEDS.forEach(value => control("speed").add(new Option(value + "\u00d7", String(value), value === 1, value === 1)));
control("seek").max = frames - 1;
control("play").onclick = () => play(!playing);
control("back").onclick = () => stepTo(shown - 1);
control("step").onclick = () => stepTo(shown + 1);
control("seek").oninput = event => stepTo(Number(event.target.value));
control("speed").onchange = event => setSpeed(Number(event.target.value));
control("loop").onclick = () => setLoop(!looping);
canvas.onclick = () => play(!playing);
document.addEventListener("keydown", pressed);
dark.addEventListener("change", resize);
new ResizeObserver(resize).observe(canvas);
resize();
play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
new IntersectionObserver(([entry]) => {
  visible = entry.isIntersecting;
  if (visible && playing) resume();
}).observe(canvas);
