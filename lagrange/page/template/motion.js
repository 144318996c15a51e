// A motion that is computed while the page plays. The exported functions compute states at equal intervals of time, and
// the last `KEPT` states are stored. The cursor is the newest state. recording.js lists the members that others use.

/** Computed states per second at speed 1. */
const PER_SECOND = 240;

/** Longest computing time per frame, in ms. If more is necessary, the picture moves slower than real time. */
const BUDGET = 10;

/** Number of states by which the step button advances: a thirtieth of a second at speed 1. */
const STEP = 8;

/** Number of states that are stored: those of one minute. */
const KEPT = 14400;

/** Number of states that are computed ahead to find the size of the picture and the limits of the axes. */
const SURVEYED = 400;

/** Largest allowed violation of a constraint at the start, relative to its terms; the first steps correct it. */
const ON_CONSTRAINTS = 9.5367431640625e-7;

/**
 * Limits of an axis after the run was computed ahead. They stay if a value is outside by less than the fraction
 * `WITHIN` of their distance. Otherwise they move beyond the value by the fraction `FURTHER`, so that they move rarely.
 */
const WITHIN = 0.04;
const FURTHER = 0.25;

/** Number of small changes into which the change of a slider is divided if the system has constraints. */
const CHANGES = 16;

/** Sentences on the reason for which a run of dop853 stopped, by its return code. */
const STOPS = {
    1: (at) => `The motion takes too many steps ${at}: something moves too fast there. Choose other values, or reset.`,
    2: (at) => `The motion leaves the finite numbers ${at}. Choose other values, or reset.`,
    3: (at) => `A matrix is singular ${at}: the accelerations are not determined there. Choose other values, or reset.`,
    4: (at) => `The steps become too small ${at}: a force grows without bound or jumps there. Choose other values, or reset.`,
    6: (at) => `The equations of a step have no solution ${at}. Choose other values, or reset.`,
    9: (at) => `The state cannot be kept on the constraints ${at}. Choose other values, or reset.`,
};

class Motion {
    constructor(model, data) {
        this.model = model;
        this.data = data;
        this.parameters = Float64Array.from(data.parameters);
        this.initial = Float64Array.from(data.initial);
        this.p = new Float64Array(Math.max(model.PREPARED, 1));
        this.size = model.STATE;
        this.perSecond = PER_SECOND;
        this.interval = data.rate / PER_SECOND;
        this.from = data.span[0] === null ? 0 : Math.max(0, data.span[0]);
        this.width = data.drawn * data.dimension;
        this.t = new Float64Array(1);
        this.y = new Float64Array(model.STATE);
        this.times = new Float64Array(KEPT);
        this.states = new Float64Array(KEPT * model.STATE);
        this.energies = new Float64Array(KEPT * 3);
        this.drifts = new Float64Array(KEPT);
        this.places = new Float64Array(KEPT * this.width);
        this.between = { t: new Float64Array(1), y: new Float64Array(model.STATE), places: new Float64Array(this.width) };
        this.restart();
    }

    /** Return to the start, with the present values of the sliders. */
    restart() {
        this.count = 0;
        this.due = 0;
        this.said = "";
        this.drift = 0;
        this.surveyed = false;
        this.low = new Float64Array(this.size + 4).fill(Infinity);
        this.high = new Float64Array(this.size + 4).fill(-Infinity);
        this.t[0] = this.from;
        this.y.set(this.initial);
        if (this.model.prepare(this.parameters, this.p)) {
            this.said = STOPS[3]("for these parameters");
            return;
        }
        const rates = new Float64Array(this.model.STATE);
        if (this.model.rhs(this.from, this.y, this.p, rates)) {
            this.said = STOPS[3]("at the start");
        } else if (!rates.every(Number.isFinite)) {
            this.said = "The accelerations have no finite value at the start. Choose other values.";
        }
        this.record();
    }

    get ended() {
        return Boolean(this.said);
    }

    get cursor() {
        return this.count - 1;
    }

    /** First and last index of the states that are kept. */
    get known() {
        return [Math.max(0, this.count - KEPT), this.count - 1];
    }

    /** Limits of an axis of time: the last ten seconds at speed 1. */
    get span() {
        const begin = this.times[this.slot(Math.max(0, this.count - WINDOW))];
        const end = begin + WINDOW * this.interval;
        return begin < end ? [begin, end] : [end, begin];
    }

    /** Index of the first state in a plot over time. */
    get first() {
        return Math.max(0, this.count - WINDOW);
    }

    /** Position of state k in the arrays. */
    slot(k) {
        return k % KEPT;
    }

    /** True if the motion jumps between two states. A computed motion never jumps. */
    jumps() {
        return false;
    }

    /** Advance by `seconds` on the screen, within the computing time `BUDGET`. Return false if the motion has ended. */
    go(seconds) {
        this.due += seconds * PER_SECOND;
        const began = performance.now();
        while (this.due >= 1 && this.advance()) {
            this.due -= 1;
            if (performance.now() - began > BUDGET) {
                this.due = Math.min(this.due, 1);
            }
        }
        this.due = this.said ? 0 : this.due;
        return !this.said;
    }

    /** Advance by `STEP` states at speed 1. `sign` has no effect, because a computed motion cannot go back. */
    step(sign, speed) {
        for (let k = Math.max(1, Math.round(STEP * speed)); k > 0 && this.advance(); k--);
        this.due = 0;
    }

    /** Compute the next state. Return true if the motion can go on. */
    advance() {
        if (this.said) {
            return false;
        }
        const until = this.from + this.count * this.interval;
        const [begin, end] = this.data.span;
        if ((end !== null && until > end) || (begin !== null && until < begin)) {
            this.said = `The given functions of time have values up to t = ${shown(this.t[0])}. Reset to see it again.`;
            return false;
        }
        if (!this.run(this.t, until, this.y)) {
            return false;
        }
        this.record();
        return !this.said;
    }

    /** Integrate the state `y` from the time `t` to `until`. Return true on success, else set `said` to the reason. */
    run(t, until, y) {
        const { tolerance, most_steps: most } = this.data;
        const outcome = this.model.dop853(t, until, y, this.p, tolerance, tolerance, most);
        if (outcome !== 0) {
            this.said = (STOPS[outcome] || ((at) => `The run stops ${at}.`))(`near t = ${shown(t[0])}`);
        }
        return outcome === 0;
    }

    /** Store the present state if it is finite. */
    record() {
        const { STATE } = this.model;
        const at = this.count % KEPT;
        const places = new Float64Array(this.width);
        const wrong = this.located(this.t[0], this.y, places) || !places.every(Number.isFinite) || !this.y.every(Number.isFinite);
        if (wrong) {
            this.said ||= `A position has no finite value near t = ${shown(this.t[0])}. Choose other values, or reset.`;
            return;
        }
        this.times[at] = this.t[0];
        this.states.set(this.y, at * STATE);
        this.places.set(places, at * this.width);
        const energies = this.energy(this.t[0], this.y);
        this.energies.set(energies, at * 3);
        this.include(this.y, energies);
        this.count += 1;
        this.measure(at);
    }

    /** Extend the limits of the axes to a state and its energies. */
    include(y, energies) {
        [...y, ...energies].forEach((value, k) => this.extend(k, value));
    }

    extend(k, value) {
        const extent = this.surveyed ? this.high[k] - this.low[k] : 0;
        if (value < this.low[k] - WITHIN * extent) {
            this.low[k] = value - FURTHER * extent;
        }
        if (value > this.high[k] + WITHIN * extent) {
            this.high[k] = value + FURTHER * extent;
        }
    }

    /** Return E, T and V of a state. */
    energy(t, y) {
        const found = [NaN, NaN, NaN];
        const out = new Float64Array(2);
        found[0] = this.model.energy(t, y, this.p, out) ? NaN : out[0];
        if (this.model.energies && !this.model.energies(t, y, this.p, out)) {
            found.splice(1, 2, out[0], out[1]);
        }
        return found;
    }

    /**
     * Update the largest change of the energy since the start. It is relative to the first energy, or to the largest
     * kinetic energy if the first energy is small. `at` is the position of the newest state in the arrays.
     */
    measure(at) {
        const energy = this.energies[at * 3];
        const largest = this.high[this.size + 1];
        this.begun = this.count === 1 ? energy : this.begun;
        const small = Number.isFinite(largest) && Math.abs(this.begun) < 1e-3 * Math.abs(largest);
        this.scale = (small ? Math.abs(largest) : Math.abs(this.begun)) || 1;
        this.largest = this.count === 1 ? 0 : Math.max(this.largest, Math.abs(energy - this.begun));
        this.drift = this.largest / this.scale;
        this.drifts[at] = (energy - this.begun) / this.scale;
        this.extend(this.size + 3, this.drifts[at]);
    }

    /** Write the positions of the points at a state into `places`. Return true if a matrix is singular. */
    located(t, y, places) {
        return this.width > 0 && this.model.positions(t, y, this.p, places);
    }

    /** Return time, state and positions at this moment, a fraction of an interval after the last stored state. */
    now() {
        const { t, y, places } = this.between;
        const share = this.due;
        t[0] = this.t[0];
        y.set(this.y);
        // If the run does not reach this time, the next whole interval reports the reason.
        if (share > 0 && !this.said && !this.reaches(t, this.t[0] + share * this.interval, y)) {
            t[0] = this.t[0];
            y.set(this.y);
        }
        const last = ((this.count - 1) % KEPT) * this.width;
        if (this.located(t[0], y, places) || !places.every(Number.isFinite)) {
            places.set(this.places.subarray(last, last + this.width));
        }
        return this.between;
    }

    /**
     * Return an object that computes the stated run ahead, for the limits of the axes and the size of the picture. Its
     * function `until(deadline)` adds positions to the list `found` until a clock time in ms. It returns true at the end.
     */
    survey() {
        const t = Float64Array.of(this.from);
        const y = this.initial.slice();
        const found = [];
        let done = Boolean(this.said);
        const add = () => {
            const places = new Float64Array(this.width);
            done = this.located(t[0], y, places) || !places.every(Number.isFinite);
            if (!done) {
                found.push(places);
                this.include(y, this.energy(t[0], y));
                const until = this.from + (this.data.t_end * found.length) / SURVEYED;
                done = found.length > SURVEYED || !this.reaches(t, until, y);
            }
        };
        const until = (deadline) => {
            while (!done && performance.now() < deadline) {
                add();
            }
            this.surveyed = done;
            return done;
        };
        return { found, until };
    }

    /** Integrate a state like `run`, but do not record the reason of a stop. */
    reaches(t, until, y) {
        const kept = this.said;
        const reached = this.run(t, until, y);
        this.said = kept;
        return reached;
    }

    /** Return the states at some times, each computed from the previous one; null after the run has stopped. */
    trajectory(times) {
        const t = Float64Array.of(this.from);
        const y = this.initial.slice();
        return times.map((until) => (until === t[0] || this.reaches(t, until, y) ? Array.from(y) : null));
    }

    /** Set a parameter, and move the initial state onto the constraints if they have a state nearby. */
    setParameter(place, value) {
        const before = this.parameters[place];
        const start = this.followed((y, share) => {
            this.parameters[place] = part(before, value, share);
            return !this.model.prepare(this.parameters, this.p) && this.onto(y) ? y : null;
        });
        this.parameters[place] = value;
        this.begin(start, "these parameters");
    }

    /** Set an entry of the initial state; with constraints the other entries change as little as possible. */
    setInitial(place, value) {
        const before = this.initial[place];
        const start = this.followed((y, share) => this.held(y, place, part(before, value, share)));
        this.begin(start, `${this.data.states[place].letter} = ${shown(value)}`);
    }

    /** Set an initial rate of rotation of a body about one of its axes. */
    setRate(place, value) {
        const before = bodyRates(this.initial, this.data.quaternions)[place];
        const start = this.followed((y, share) => {
            turnWith(y, this.data.quaternions, place, part(before, value, share));
            return this.onto(y) ? y : null;
        });
        this.begin(start, "this rate");
    }

    /** Restart from the state `start`. If it is null, restart from the present start and report this. */
    begin(start, what) {
        this.initial.set(start || this.initial);
        this.restart();
        if (!start) {
            this.said ||= `The constraints have no state near this one with ${what}.`;
        }
    }

    /**
     * Return the initial state after a change, or null. With constraints the change is made in small parts, because
     * Newton's method finds only solutions nearby. `change(y, share)` returns the state after a part of the change.
     */
    followed(change) {
        let y = this.initial.slice();
        const parts = this.model.projection ? CHANGES : 1;
        for (let k = 1; k <= parts && y !== null; k++) {
            y = change(y, k / parts);
        }
        return y;
    }

    /** Return the nearby state on the constraints whose entry `place` is `value`, by the secant method, or null. */
    held(from, place, value) {
        let entry = value;
        let slope = 1;
        let last = null;
        for (let k = 0; k < 40 && Number.isFinite(entry); k++) {
            const y = from.slice();
            y[place] = entry;
            if (!this.onto(y)) {
                return null;
            }
            const off = value - y[place];
            if (Math.abs(off) <= 1e-12 * Math.max(1, Math.abs(value))) {
                return y;
            }
            if (last !== null && y[place] !== last.found) {
                slope = (entry - last.entry) / (y[place] - last.found);
            }
            last = { entry, found: y[place] };
            entry += slope * off;
        }
        return null;
    }

    /** Move a state onto the constraints by Newton's method; return true on success. */
    onto(y) {
        const { STATE, projection } = this.model;
        if (!projection) {
            return true;
        }
        const found = new Float64Array(STATE + 2);
        for (let k = 0; k < 30; k++) {
            if (projection(this.from, y, this.p, found, 0) || !found.every(Number.isFinite)) {
                return false;
            }
            if (found[STATE] <= 4e-16) {
                return true;
            }
            if (k > 20 && found[STATE] <= ON_CONSTRAINTS) {
                return true;
            }
            for (let i = 0; i < STATE; i++) {
                y[i] += found[i];
            }
        }
        return found[STATE] <= ON_CONSTRAINTS;
    }
}
