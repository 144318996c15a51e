// A motion that is computed: states at equal intervals, by the exported functions, the last of which are kept.
// Its cursor is the newest state. The other scripts know of it what they know of a `Recording`.

/** Intervals per second at speed 1. */
const PER_SECOND = 240;

/** Computing time in a frame, in ms: if it is exceeded, the picture runs slower than real time. */
const BUDGET = 10;

/** Recorded states in a step: a thirtieth of a second at speed 1. */
const STEP = 8;

/** Number of states that are kept: a minute of them. */
const KEPT = 14400;

/** Number of states that are computed ahead for the size of the picture. */
const SURVEYED = 400;

/** Largest violation of a constraint at the start, relative to its terms; the first steps correct it. */
const ON_CONSTRAINTS = 9.5367431640625e-7;

/**
 * After the motion ahead is known, its axes stay while values are within this part of their extent beside it, for which
 * they have room, and else move further by this part, so that they move rarely.
 */
const WITHIN = 0.04;
const FURTHER = 0.25;

/** Number of parts in which a value is changed if constraints restrict the start. */
const CHANGES = 16;

/** Reasons for which a run of dop853 stopped, by its return code. */
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

    /** Place of state k in the arrays. */
    slot(k) {
        return k % KEPT;
    }

    /** True if the state jumps between two states: never here. */
    jumps() {
        return false;
    }

    /** Advance by all intervals of some seconds on the screen, within the budget of a frame; return false at an end. */
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

    /** Advance by a step. */
    step(sign, speed) {
        for (let k = Math.max(1, Math.round(STEP * speed)); k > 0 && this.advance(); k--);
        this.due = 0;
    }

    /** Advance by one interval; return true if its end was reached. */
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

    /** Run a state to a time, or record the reason why it stopped. */
    run(t, until, y) {
        const { tolerance, most_steps: most } = this.data;
        const outcome = this.model.dop853(t, until, y, this.p, tolerance, tolerance, most);
        if (outcome !== 0) {
            this.said = (STOPS[outcome] || ((at) => `The run stops ${at}.`))(`near t = ${shown(t[0])}`);
        }
        return outcome === 0;
    }

    /** Record the state if it is finite. */
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

    /** Extend the bounds of the axes to a state and its energies. */
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

    /** Keep the largest drift, relative to the first energy, or to the largest kinetic energy if the first is small. */
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

    /** Write the positions of the points at a state; return true if a matrix is singular. */
    located(t, y, places) {
        return this.width > 0 && this.model.positions(t, y, this.p, places);
    }

    /** Return time, state and positions at this moment, a part of an interval after the last recorded state. */
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
     * Prepare to compute the run of the scene ahead, for the axes and the size of the picture: `until` fills `found` with
     * positions and returns true at the end.
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

    /** Run a state to a time; return true if it was reached. The reason of a stop is not recorded. */
    reaches(t, until, y) {
        const kept = this.said;
        const reached = this.run(t, until, y);
        this.said = kept;
        return reached;
    }

    /** Return states at times, each computed from the one before; null from where the run stops. */
    trajectory(times) {
        const t = Float64Array.of(this.from);
        const y = this.initial.slice();
        return times.map((until) => (until === t[0] || this.reaches(t, until, y) ? Array.from(y) : null));
    }

    /** Set a parameter; the start is moved onto the constraints if there is a state nearby. */
    setParameter(place, value) {
        const before = this.parameters[place];
        const start = this.followed((y, share) => {
            this.parameters[place] = part(before, value, share);
            return !this.model.prepare(this.parameters, this.p) && this.onto(y) ? y : null;
        });
        this.parameters[place] = value;
        this.begin(start, "these parameters");
    }

    /** Set an entry of the start; with constraints the others change as little as possible. */
    setInitial(place, value) {
        const before = this.initial[place];
        const start = this.followed((y, share) => this.held(y, place, part(before, value, share)));
        this.begin(start, `${this.data.states[place].letter} = ${shown(value)}`);
    }

    /** Set a rate about an axis of a body at the start. */
    setRate(place, value) {
        const before = bodyRates(this.initial, this.data.quaternions)[place];
        const start = this.followed((y, share) => {
            turnWith(y, this.data.quaternions, place, part(before, value, share));
            return this.onto(y) ? y : null;
        });
        this.begin(start, "this rate");
    }

    /** Begin from a new start, or keep the present one and report that none is nearby. */
    begin(start, what) {
        this.initial.set(start || this.initial);
        this.restart();
        if (!start) {
            this.said ||= `The constraints have no state near this one with ${what}.`;
        }
    }

    /** Return the start after a change; with constraints in small parts, since other solutions are far away. */
    followed(change) {
        let y = this.initial.slice();
        const parts = this.model.projection ? CHANGES : 1;
        for (let k = 1; k <= parts && y !== null; k++) {
            y = change(y, k / parts);
        }
        return y;
    }

    /** Return a nearby state on the constraints in which an entry has a value, or null: by the secant method. */
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
