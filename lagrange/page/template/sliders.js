// Sliders: each has a number field beside it.

/** Number of positions of a slider: its value is rounded to a digit finer than one of them. */
const STEPS = 500;

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

    /** Return the value of a slider, without superfluous digits. */
    rounded({ range, value }) {
        const [low, high, at] = [range.min, range.max, range.value].map(Number);
        const step = 10 ** Math.floor(Math.log10((high - low) / STEPS));
        return Math.abs(at - value) < 0.5 * step ? value : Number((Math.round(at / step) * step).toPrecision(12));
    }

    set(row, value) {
        if (row.kind === "parameter") {
            this.motion.setParameter(row.place, value);
        } else {
            this.motion.setInitial(row.place, value);
        }
        this.read();
        this.changed();
    }

    /** Show the present values: constraints may have changed other values than the one that was set. */
    read() {
        for (const row of this.rows) {
            const value = (row.kind === "parameter" ? this.motion.parameters : this.motion.initial)[row.place];
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
