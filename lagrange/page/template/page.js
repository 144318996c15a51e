// The page: time advances, states are computed, and everything is drawn.

/** Computing time in a frame, in ms: if it is exceeded, the picture runs slower than real time. */
const BUDGET = 10;

/** A motion that has grown beyond this multiple of its first size is paused: it leaves the picture. */
const GROWTH = 3;

/** Frames between two updates of the numbers, so that they can be read. */
const READ = 5;

/** Recorded states in a step: a thirtieth of a second at speed 1. */
const STEP = 8;

/** Colours and font from the style sheet, read once for each style. */
class Look {
    constructor(count) {
        this.count = count;
        this.read();
    }

    read() {
        const style = getComputedStyle(document.documentElement);
        const value = (name) => style.getPropertyValue(`--${name}`).trim();
        Object.assign(this, { paper: value("paper"), ink: value("ink"), quiet: value("quiet"), grid: value("grid") });
        this.colours = Array.from({ length: this.count }, (_, k) => value(`colour${k}`));
        this.font = `12px ${getComputedStyle(document.body).fontFamily}`;
    }
}

class Player {
    constructor(model, data) {
        this.data = data;
        this.motion = new Motion(model, data);
        this.look = new Look(Math.max(data.points.length, data.states.length / 2, 3));
        this.picture = new Picture(document.getElementById("picture"), this.motion, this.look);
        this.timePlot = new Plot(document.getElementById("time-plot"), this.look);
        this.phasePlot = new Plot(document.getElementById("phase-plot"), this.look);
        this.coordinatePlot = new Plot(document.getElementById("picture"), this.look);
        this.due = 0;
        this.limit = GROWTH;
        this.frames = 0;
        this.choices();
        this.describe();
        this.picture.survey(true);
        this.sliders = new Sliders(this.motion, () => this.changed());
        this.playing = !window.matchMedia("(prefers-reduced-motion: reduce)").matches;
        this.controls = new Controls(this);
        this.play(this.playing);
        new ResizeObserver(() => this.redraw()).observe(document.body);
        requestAnimationFrame((now) => this.frame(now));
    }

    /** Fill the list of quantities for the plot over time. */
    choices() {
        const { energies } = this.motion.model;
        const named = [
            ["energies", energies ? "energies over time" : "energy over time"],
            ["drift", this.data.kept ? "energy drift over time" : "change of the energy over time"],
            ["coordinates", "coordinates over time"],
        ];
        const select = document.getElementById("over-time");
        named.forEach(([value, text]) => select.append(new Option(text, value)));
        select.addEventListener("change", () => this.redraw());
        document.getElementById("phase").addEventListener("change", () => this.redraw());
        document.getElementById("drift-name").textContent = this.data.kept ? "energy drift" : "energy change";
    }

    /** Describe the pictures in words, for screen readers. */
    describe() {
        const { name, points, dimension } = this.data;
        const what = dimension ? `the points ${points.join(", ")}` : "the coordinates over time";
        const say = (id, text) => document.getElementById(id).setAttribute("aria-label", text);
        say("picture", `Moving picture of ${name}: ${what}`);
        say("time-plot", `Plot over time of ${name}`);
        say("phase-plot", `Phase plane of ${name}: a coordinate and its velocity`);
    }

    /** Play or pause; a motion that has stopped begins again. */
    play(wanted) {
        if (wanted && this.motion.said) {
            this.motion.restart();
            this.due = 0;
        }
        if (wanted && this.picture.left(this.limit)) {
            this.limit = GROWTH * this.picture.view.growth();
        }
        this.wanted = wanted;
        this.goOn();
    }

    /** Advance time if the page is playing and the motion has not stopped. */
    goOn() {
        this.playing = this.wanted && !this.motion.said;
        document.getElementById("play").textContent = this.playing ? "Pause" : "Play";
        this.redraw();
    }

    step() {
        this.play(false);
        for (let k = Math.max(1, Math.round(STEP * this.speed)); k > 0 && this.motion.advance(); k--);
        this.due = 0;
        this.redraw();
    }

    reset() {
        this.motion.restart();
        this.changed();
    }

    /** Begin again with the present values of the sliders. */
    changed() {
        this.due = 0;
        this.limit = GROWTH;
        this.picture.survey(false);
        this.goOn();
    }

    redraw() {
        this.stale = true;
    }

    /** Advance time by all intervals that are due, within the budget of a frame. */
    pass(seconds) {
        this.due += seconds * this.speed * PER_SECOND;
        const began = performance.now();
        while (this.due >= 1 && this.motion.advance()) {
            this.due -= 1;
            if (performance.now() - began > BUDGET) {
                this.due = Math.min(this.due, 1);
            }
        }
        if (this.motion.said) {
            this.due = 0;
            this.goOn();
        }
        if (this.picture.left(this.limit)) {
            this.play(false);
        }
    }

    frame(now) {
        const seconds = Math.min(0.1, Math.max(0, (now - (this.last ?? now)) / 1000));
        this.last = now;
        this.picture.lookAhead(LOOK_ON);
        if (this.playing) {
            this.pass(seconds);
            this.stale = true;
        }
        if (this.stale) {
            this.stale = false;
            this.draw();
        }
        this.frames += 1;
        requestAnimationFrame((next) => this.frame(next));
    }

    draw() {
        const { motion } = this;
        this.say();
        if (!this.playing || this.frames % READ === 0) {
            this.tell();
        }
        if (motion.count === 0) {
            return;
        }
        const now = motion.now(this.due);
        if (this.data.dimension) {
            this.picture.draw(now.places, this.playing ? 0.08 : 1);
        } else {
            this.overTime(this.coordinatePlot, "coordinates");
        }
        // While time advances, each plot is drawn in every second frame.
        if (!this.playing || this.frames % 2 === 0) {
            this.overTime(this.timePlot, document.getElementById("over-time").value);
        }
        if (!this.playing || this.frames % 2 === 1) {
            this.phasePlot.phase(motion, Number(document.getElementById("phase").value), now.y);
        }
    }

    /** Draw the chosen quantity over time. */
    overTime(plot, what) {
        const { motion, look } = this;
        const { STATE } = motion.model;
        const time = this.data.unit.t ? `t (${this.data.unit.t})` : "t";
        const bounds = (from, to) => [Math.min(...motion.low.subarray(from, to)), Math.max(...motion.high.subarray(from, to))];
        if (what === "coordinates") {
            const rows = this.data.states.slice(0, STATE / 2).map(({ letter }, k) => ({
                name: letter,
                colour: look.colours[k],
                value: (at) => motion.states[at * STATE + k],
            }));
            plot.overTime(motion, rows, bounds(0, STATE / 2), [time, ""]);
            plot.names(rows);
        } else if (what === "drift") {
            const value = (at) => (motion.energies[at * 3] - motion.first) / motion.scale;
            const row = { name: "(E − E₀) relative", colour: look.ink, value };
            const change = [motion.low[STATE], motion.high[STATE]].map((energy) => (energy - motion.first) / motion.scale);
            plot.overTime(motion, [row], change[0] === change[1] ? [-1e-15, 1e-15] : change, [time, ""]);
            plot.names([row]);
        } else {
            const value = (k) => (at) => motion.energies[at * 3 + k];
            const names = motion.model.energies ? ["E", "T", "V"] : ["E"];
            const colours = [look.ink, look.colours[0], look.colours[1]];
            const rows = names.map((name, k) => ({ name, colour: colours[k], value: value(k) }));
            plot.overTime(motion, rows, bounds(STATE, STATE + names.length), [time, ""]);
            plot.names(rows);
        }
    }

    /** Report in a sentence why the motion stopped, or that it leaves the picture. */
    say() {
        const left = this.picture.left(this.limit) ? "The motion leaves the picture: play goes on, reset begins again." : "";
        write("said", this.motion.said || left);
        document.getElementById("said").classList.toggle("calm", !this.motion.said);
    }

    /** Write the numbers. */
    tell() {
        const { motion, data } = this;
        const time = motion.t[0] + this.due * motion.interval;
        write("time", `${steady(time, Math.abs(data.rate) < 1 ? 4 : 2)} ${data.unit.t}`.trim());
        const energy = motion.count ? motion.energies[((motion.count - 1) % KEPT) * 3] : NaN;
        write("energy", Number.isFinite(energy) ? shown(energy, 6) : "no value");
        const drift = data.kept ? motion.drift : energy - motion.first;
        write("drift", Number.isFinite(drift) ? shown(drift, data.kept ? 2 : 4) : "no value");
    }
}

/** Set the text of an element only if it changes, so that screen readers do not announce it again. */
function write(id, text) {
    const element = document.getElementById(id);
    if (element.textContent !== text) {
        element.textContent = text;
    }
}

/** Start the page with the functions of the exported module. */
function startPage(model) {
    const data = JSON.parse(document.getElementById("data").textContent);
    const player = new Player(model, data);
    window.lagrange = Object.freeze({
        trajectory: (times) => player.motion.trajectory(Array.from(times)),
        state: () => ({ t: player.motion.t[0], y: Array.from(player.motion.y) }),
        values: () => ({ parameters: Array.from(player.motion.parameters), initial: Array.from(player.motion.initial) }),
        frames: () => player.frames,
    });
}
