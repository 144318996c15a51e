// Sliders of a page, each with a number field beside it, and the function that starts such a page.

/** Number of positions of a slider. Values are rounded to a power of ten below the distance of two positions. */
const STEPS = 500;

/**
 * Return the rates of rotation of bodies about their axes at a state, three for each body. They are the vector part of
 * 2 q* dq/dt / |q|^2 for the quaternion q.
 */
function bodyRates(y, quaternions) {
    const half = y.length / 2;
    return quaternions.flatMap((rows) => {
        const [w, i, j, k] = rows.map((row) => y[row]);
        const [a, b, c, d] = rows.map((row) => y[half + row]);
        const twice = 2 / (w * w + i * i + j * j + k * k);
        const turned = [w * b - i * a - j * d + k * c, w * c - j * a - k * b + i * d, w * d - k * a - i * c + j * b];
        return turned.map((rate) => twice * rate);
    });
}

/** Set the rate of rotation number `place` in a state. The derivative of the quaternion q is q (0, rates)/2. */
function turnWith(y, quaternions, place, value) {
    const rows = quaternions[Math.floor(place / 3)];
    const rates = bodyRates(y, [rows]);
    rates[place % 3] = value;
    const [[a, b, c], [w, i, j, k]] = [rates, rows.map((row) => y[row])];
    const twice = [-i * a - j * b - k * c, w * a + j * c - k * b, w * b + k * a - i * c, w * c + i * b - j * a];
    rows.forEach((row, at) => {
        y[y.length / 2 + row] = twice[at] / 2;
    });
}

class Sliders {
    constructor(motion, changed) {
        this.motion = motion;
        this.changed = changed;
        this.rows = motion.data.sliders.map((row, k) => ({
            ...row,
            range: document.getElementById(`slider${k}`),
            number: document.getElementById(`number${k}`),
            unit: document.getElementById(`unit${k}`),
        }));
        this.rows.forEach((row) => this.listen(row));
        this.read();
    }

    listen(row) {
        row.range.addEventListener("input", () => this.set(row, this.rounded(row)));
        row.number.addEventListener("change", () => {
            const value = Number(row.number.value);
            if (row.number.value.trim() === "" || !Number.isFinite(value)) {
                this.read();
            } else {
                this.set(row, value);
            }
        });
    }

    /** Return the value of a slider, rounded to the digits that its position determines. */
    rounded({ range, value }) {
        const [low, high, at] = [range.min, range.max, range.value].map(Number);
        const step = 10 ** Math.floor(Math.log10((high - low) / STEPS));
        return Math.abs(at - value) < 0.5 * step ? value : Number((Math.round(at / step) * step).toPrecision(12));
    }

    set(row, value) {
        if (row.kind === "parameter") {
            this.motion.setParameter(row.place, value);
        } else if (row.kind === "rate") {
            this.motion.setRate(row.place, value);
        } else {
            this.motion.setInitial(row.place, value);
        }
        this.read();
        this.changed();
    }

    /** Show the present values of all sliders, because constraints may have changed several values. */
    read() {
        const { parameters, initial } = this.motion;
        const values = { parameter: parameters, state: initial, rate: bodyRates(initial, this.motion.data.quaternions) };
        for (const row of this.rows) {
            const value = values[row.kind][row.place];
            row.range.min = String(Math.min(Number(row.range.min), value));
            row.range.max = String(Math.max(Number(row.range.max), value));
            row.range.value = String(value);
            if (document.activeElement !== row.number || Number(row.number.value) !== value) {
                row.number.value = String(Number(value.toPrecision(6)));
            }
            const degrees = `${shown((value * 180) / Math.PI, 3)}°`;
            row.range.setAttribute("aria-valuetext", row.angle ? `${shown(value)}, ${degrees}` : shown(value));
            if (row.angle) {
                row.unit.textContent = degrees;
            }
        }
    }

    /** Return to the initial values of the page. */
    restore() {
        this.motion.parameters.set(this.motion.data.parameters);
        this.motion.initial.set(this.motion.data.initial);
        this.motion.restart();
        this.read();
        this.changed();
    }
}

/** Start the page with the functions of the exported module. */
function startPage(model) {
    const data = JSON.parse(document.getElementById("data").textContent);
    const player = new Player(new Motion(model, data), data);
    player.sliders = new Sliders(player.motion, () => player.changed());
    window.lagrange = Object.freeze({
        trajectory: (times) => player.motion.trajectory(Array.from(times)),
        state: () => ({ t: player.motion.t[0], y: Array.from(player.motion.y) }),
        values: () => ({ parameters: Array.from(player.motion.parameters), initial: Array.from(player.motion.initial) }),
        limits: () => [Array.from(player.motion.low), Array.from(player.motion.high)],
        frames: () => player.frames,
    });
}
