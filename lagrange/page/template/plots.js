// The plots of a page: quantities over time, and the phase plane.

/** Number of states in a plot over time: ten seconds at speed 1. */
const WINDOW = 2400;

/** Number of states in the phase plane, and the largest number of them that is drawn. */
const PHASE = 7200;
const PHASE_PARTS = 1800;

/** Opacity of the part of a curve after the present time. */
const FAINT = 0.3;

/** Margins around the curves in pixels; the names of curves are in the margin above. */
const PAD = { left: 52, right: 10, top: 22, bottom: 32 };

class Plot {
    constructor(canvas, look) {
        this.canvas = canvas;
        this.look = look;
    }

    /** Draw axes with the limits `xs` and `ys`, tick marks and names, and store the functions from values to pixels. */
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
        context.fillText([names[1], up.factor].filter(Boolean).join(" in "), 2, 2);
        context.save();
        context.beginPath();
        context.rect(PAD.left, PAD.top, w, h);
        context.clip();
        return { context, w };
    }

    /** Draw the curves `rows` over time: opaque up to the present time, and pale after it as far as they are known. */
    overTime(motion, rows, bounds, names) {
        const { cursor, first, known } = motion;
        const time = (k) => motion.times[motion.slot(k)];
        const { context, w } = this.axes(motion.span, bounds, names);
        const draw = (value, last) => {
            const stride = Math.max(1, Math.floor((2 * (known[1] - first + 1)) / w));
            context.beginPath();
            let before = first;
            this.extremes(first, last, stride, (k) => value(motion.slot(k)), (k) => {
                const to = motion.jumps(before, k) ? "moveTo" : "lineTo";
                context[to](this.x(time(k)), this.y(value(motion.slot(k))));
                before = k;
            });
            context.stroke();
        };
        context.lineWidth = 1.6;
        for (const { value, colour } of rows) {
            context.strokeStyle = context.fillStyle = colour;
            if (cursor < known[1]) {
                context.globalAlpha = FAINT;
                draw(value, known[1]);
                context.globalAlpha = 1;
            }
            draw(value, cursor);
        }
        if (known[1] > cursor || motion.frames) {
            context.strokeStyle = this.look.quiet;
            context.lineWidth = 1;
            context.beginPath();
            segment(context, this.x(time(cursor)), PAD.top, this.x(time(cursor)), this.canvas.clientHeight - PAD.bottom);
            context.stroke();
            rows.forEach(({ value, colour }) => this.dot(context, time(cursor), value(motion.slot(cursor)), colour, 3.5));
        }
        context.restore();
    }

    dot(context, x, y, colour, radius) {
        context.fillStyle = colour;
        context.beginPath();
        context.arc(this.x(x), this.y(y), radius, 0, 2 * Math.PI);
        context.fill();
    }

    /** Call `draw` with the state of smallest and of largest value of each `stride` states, ordered by time. */
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

    /** Draw states in the plane of coordinate number `place` and its velocity, and a dot at the present state `now`. */
    phase(motion, place, now) {
        const { size, known, cursor } = motion;
        const n = size / 2;
        const { states } = motion.data;
        const bounds = [place, place + n].map((k) => around(motion.low[k], motion.high[k]));
        const { context } = this.axes(...bounds, [place, place + n].map((k) => withUnit(states[k])));
        const from = Math.max(known[0], motion.frames ? 0 : cursor + 1 - PHASE);
        const stride = Math.max(1, Math.ceil((known[1] - from) / PHASE_PARTS));
        const colour = this.look.colours[0];
        const at = (k) => motion.slot(k) * size + place;
        const draw = (last, opacity) => {
            context.globalAlpha = opacity;
            context.beginPath();
            for (let k = Math.ceil(from / stride) * stride; k <= last; k += stride) {
                context[motion.jumps(k - stride, k) ? "moveTo" : "lineTo"](this.x(motion.states[at(k)]), this.y(motion.states[at(k) + n]));
            }
        };
        context.strokeStyle = colour;
        context.lineWidth = 1.3;
        if (cursor < known[1]) {
            draw(known[1], FAINT);
            context.stroke();
        }
        draw(cursor, 0.7);
        context.lineTo(this.x(now[place]), this.y(now[place + n]));
        context.stroke();
        context.globalAlpha = 1;
        this.dot(context, now[place], now[place + n], colour, 5);
        context.restore();
    }

    /** Write names in their colours above a plot. */
    names(rows) {
        const context = this.canvas.getContext("2d");
        context.font = this.look.font;
        context.textAlign = "right";
        context.textBaseline = "top";
        let x = this.canvas.clientWidth - PAD.right;
        for (const { name, colour } of [...rows].reverse()) {
            context.fillStyle = colour;
            context.fillText(name, x, 2);
            x -= context.measureText(name).width + 12;
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
