// The motion of a recorded run: all states are known, and a cursor moves among them. No formulas are evaluated.
//
// `Recording` and `Motion` both have these members, which the other scripts use:
//   size, width       number of entries of a state, and of coordinates of all points
//   known             first and last index of the states that can be drawn
//   cursor, first     index of the present state, and of the first state in a plot over time
//   slot(k)           position of state k in the arrays times, states, energies (E, T, V), drifts and places
//   jumps(from, to)   true if no line is drawn from one state to another
//   low, high, span   limits of the axes of the entries of the state, E, T, V and drift, and of the time axis
//   now()             time, state and positions at this moment
//   go, step, restart, said, ended, survey
// A recording also has seek, frames and loops.

/** Largest number of states from which the size of the picture is computed. */
const SEEN = 4000;

class Recording {
    constructor(data, bytes) {
        const { count, detail, fps, begin, end, rows, jumps } = data.record;
        this.data = data;
        this.size = data.states.length;
        this.width = data.drawn * data.dimension;
        this.detail = detail;
        this.frames = (count - 1) / detail + 1;
        this.perSecond = fps * detail;
        this.last = count - 1;
        this.jumpAt = jumps;
        this.loops = true;
        this.said = "";
        this.first = 0;
        this.place = 0;
        const values = unpacked(bytes, rows, count);
        this.times = Float64Array.from({ length: count }, (_, k) => begin + ((end - begin) * k) / Math.max(1, count - 1));
        this.span = count > 1 ? [Math.min(begin, end), Math.max(begin, end)] : [begin - 0.5, begin + 0.5];
        this.places = columns(values.slice(0, this.width), count, this.width);
        const others = values.slice(this.width);
        this.states = columns(others.slice(0, this.size), count, this.size);
        const energies = data.energies.map((_, k) => others[this.size + k]);
        this.energies = columns(energies, count, 3);
        this.drifts = others[this.size + energies.length];
        const bounded = [...others.slice(0, this.size), ...[0, 1, 2].map((k) => energies[k]), this.drifts];
        this.low = bounded.map((row) => (row ? row.reduce((a, b) => Math.min(a, b)) : NaN));
        this.high = bounded.map((row) => (row ? row.reduce((a, b) => Math.max(a, b)) : NaN));
    }

    get cursor() {
        return Math.floor(this.place);
    }

    get known() {
        return [0, this.last];
    }

    get ended() {
        return this.place >= this.last;
    }

    slot(k) {
        return k;
    }

    jumps(from, to) {
        return this.jumpAt.some((k) => from <= k && k < to);
    }

    /** Return time, state and positions at this moment, by linear interpolation between two recorded states. */
    now() {
        const k = Math.min(this.cursor, this.last);
        const share = k < this.last && !this.jumps(k, k + 1) ? this.place - k : 0;
        const mixed = (array, width) =>
            Float64Array.from({ length: width }, (_, i) => part(array[k * width + i], array[(k + Boolean(share)) * width + i], share));
        const t = part(this.times[k], this.times[Math.min(k + 1, this.last)], this.place - k);
        return { t: [t], y: mixed(this.states, this.size), places: mixed(this.places, this.width) };
    }

    /** Move on by `seconds` on the screen. Return false at the end of the recording, unless it plays in a loop. */
    go(seconds) {
        this.place += seconds * this.perSecond;
        if (this.place >= this.last) {
            this.place = this.loops && this.last > 0 ? this.place % this.last : this.last;
            return this.loops && this.last > 0;
        }
        return true;
    }

    /** Go to the next frame, or to the previous frame if `sign` is negative. */
    step(sign) {
        const frame = this.place / this.detail;
        this.seek(sign > 0 ? Math.floor(frame) + 1 : Math.ceil(frame) - 1);
    }

    /** Go to the frame with this number. */
    seek(frame) {
        this.place = Math.min(this.last, Math.max(0, frame * this.detail));
    }

    restart() {
        this.place = 0;
    }

    /** Return positions along the whole recording, which determine the size of the picture. */
    survey() {
        const stride = Math.ceil((this.last + 1) / SEEN);
        const found = [];
        for (let k = 0; this.width > 0 && k <= this.last; k += stride) {
            found.push(this.places.subarray(k * this.width, (k + 1) * this.width));
        }
        return { found, until: () => true };
    }
}

/**
 * Return the numbers of each row of a recording. `bytes` has the second differences of whole numbers, all low bytes
 * before all high bytes. `rows` has the least value and the step of the grid of each row.
 */
function unpacked(bytes, rows, count) {
    const half = rows.length * count;
    return rows.map(([base, grain], row) => {
        const whole = Int16Array.from({ length: count }, (_, k) => bytes[row * count + k] | (bytes[half + row * count + k] << 8));
        for (let again = 0; again < 2; again++) {
            for (let k = 1; k < count; k++) {
                whole[k] += whole[k - 1];
            }
        }
        return Float64Array.from(whole, (value) => base + grain * value);
    });
}

/** Return rows as one array, in which the `width` numbers of a state are neighbours; missing rows are NaN. */
function columns(rows, count, width) {
    const found = new Float64Array(count * width).fill(NaN);
    rows.forEach((row, i) => row.forEach((value, k) => (found[k * width + i] = value)));
    return found;
}

/** Start the player of a recording. `bytes` are the decompressed numbers of its rows. */
function startRecording(bytes) {
    const data = JSON.parse(document.getElementById("data").textContent);
    const player = new Player(new Recording(data, bytes), data);
    window.lagrange = Object.freeze({
        seek: (t) => {
            const { motion } = player;
            const { begin, end } = data.record;
            player.play(false);
            motion.place = end === begin ? 0 : (motion.last * (t - begin)) / (end - begin);
        },
        state: () => ({ t: player.motion.now().t[0], y: Array.from(player.motion.now().y) }),
        frames: () => player.frames,
    });
}
