// Plots: quantities over time, and the phase plane.

/** Number of recorded states in a plot over time: ten seconds at speed 1. */
const WINDOW = 2400;

/** Number of recorded states in the phase plane, and number of those drawn. */
const PHASE = 7200;
const PHASE_PARTS = 1800;

const PAD = { left: 58, right: 10, top: 8, bottom: 34 };

class Plot {
    constructor(canvas, look) {
        this.canvas = canvas;
        this.look = look;
    }

    /** Draw axes with tick marks and names, and store the map from values to pixels. */
    axes(xs, ys, names) {
        const { context, width, height } = sized(this.canvas);
        const { look } = this;
        const [w, h] = [width - PAD.left - PAD.right, height - PAD.top - PAD.bottom];
        this.x = (value) => PAD.left + (w * (value - xs[0])) / (xs[1] - xs[0]);
        this.y = (value) => PAD.top + h - (h * (value - ys[0])) / (ys[1] - ys[0]);
        context.font = look.font;
        context.lineWidth = 1;
        context.strokeStyle = look.grid;
        context.fillStyle = look.quiet;
        const across = marks(...xs, Math.max(2, w / 80));
        const up = marks(...ys, Math.max(2, h / 40));
        context.beginPath();
        across.places.forEach((value) => segment(context, this.x(value), PAD.top, this.x(value), PAD.top + h));
        up.places.forEach((value) => segment(context, PAD.left, this.y(value), PAD.left + w, this.y(value)));
        context.stroke();
        context.textAlign = "center";
        context.textBaseline = "top";
        across.places.forEach((value, k) => context.fillText(across.texts[k], this.x(value), PAD.top + h + 4));
        context.textAlign = "right";
        context.textBaseline = "middle";
        up.places.forEach((value, k) => context.fillText(up.texts[k], PAD.left - 6, this.y(value)));
        context.fillStyle = look.ink;
        context.textBaseline = "bottom";
        context.fillText([names[0], across.factor].filter(Boolean).join(" in "), PAD.left + w, height - 1);
        context.textAlign = "left";
        context.textBaseline = "top";
        context.fillText([names[1], up.factor].filter(Boolean).join(" in "), PAD.left + 6, PAD.top + 2);
        context.save();
        context.beginPath();
        context.rect(PAD.left, PAD.top, w, h);
        context.clip();
        return { context, w };
    }

    /** Draw rows of recorded numbers over time; each of `rows` has a function of the index of a state, and a colour. */
    overTime(motion, rows, bounds, names) {
        const last = motion.count - 1;
        const first = Math.max(0, motion.count - Math.min(WINDOW, KEPT));
        const time = (k) => motion.times[k % KEPT];
        const span = WINDOW * motion.interval;
        const begin = time(first);
        const { context, w } = this.axes(span > 0 ? [begin, begin + span] : [begin + span, begin], roomy(...bounds), names);
        const stride = Math.max(1, Math.floor((2 * WINDOW) / w));
        context.lineWidth = 1.6;
        for (const { value, colour } of rows) {
            context.strokeStyle = colour;
            context.beginPath();
            this.extremes(first, last, stride, (k) => value(k % KEPT), (k) => context.lineTo(this.x(time(k)), this.y(value(k % KEPT))));
            context.stroke();
        }
        context.restore();
    }

    /** Call `draw` with the smallest and the largest value of each group of states, in their order in time. */
    extremes(first, last, stride, value, draw) {
        if (stride < 3) {
            for (let k = first; k <= last; k++) {
                draw(k);
            }
            return;
        }
        for (let begin = Math.floor(first / stride) * stride; begin <= last; begin += stride) {
            let [low, high] = [Math.max(begin, first), Math.max(begin, first)];
            for (let k = low; k < begin + stride && k <= last; k++) {
                low = value(k) < value(low) ? k : low;
                high = value(k) > value(high) ? k : high;
            }
            draw(Math.min(low, high));
            draw(Math.max(low, high));
        }
        draw(last);
    }

    /** Draw the recorded states in the plane of a coordinate and its velocity, and mark the present one. */
    phase(motion, place, now) {
        const { STATE } = motion.model;
        const n = STATE / 2;
        const { states } = motion.data;
        const bounds = [place, place + n].map((k) => roomy(motion.low[k], motion.high[k]));
        const { context } = this.axes(...bounds, [place, place + n].map((k) => withUnit(states[k])));
        const length = Math.min(PHASE, motion.count, KEPT);
        const stride = Math.max(1, Math.ceil(length / PHASE_PARTS));
        const first = Math.ceil((motion.count - length) / stride) * stride;
        const colour = this.look.colours[0];
        context.strokeStyle = colour;
        context.lineWidth = 1.3;
        context.globalAlpha = 0.7;
        context.beginPath();
        for (let k = first; k < motion.count; k += stride) {
            const at = (k % KEPT) * STATE + place;
            context.lineTo(this.x(motion.states[at]), this.y(motion.states[at + n]));
        }
        context.lineTo(this.x(now[place]), this.y(now[place + n]));
        context.stroke();
        context.globalAlpha = 1;
        context.fillStyle = colour;
        context.beginPath();
        context.arc(this.x(now[place]), this.y(now[place + n]), 5, 0, 2 * Math.PI);
        context.fill();
        context.restore();
    }

    /** Write names in their colours at the top of a plot. */
    names(rows) {
        const { look } = this;
        const context = this.canvas.getContext("2d");
        context.font = look.font;
        context.textAlign = "right";
        context.textBaseline = "top";
        let x = this.canvas.clientWidth - PAD.right - 4;
        for (const { name, colour } of [...rows].reverse()) {
            context.fillStyle = look.paper;
            const wide = context.measureText(name).width;
            context.globalAlpha = 0.75;
            context.fillRect(x - wide - 4, PAD.top + 1, wide + 8, 16);
            context.globalAlpha = 1;
            context.fillStyle = colour;
            context.fillText(name, x, PAD.top + 3);
            x -= wide + 12;
        }
    }
}

function segment(context, x0, y0, x1, y1) {
    context.moveTo(x0, y0);
    context.lineTo(x1, y1);
}

/** Return the symbol of an entry of the state, with its unit. */
function withUnit({ letter, unit }) {
    return unit ? `${letter} (${unit})` : letter;
}
