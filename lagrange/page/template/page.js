// The player of a page: it advances the time, draws picture and plots, and writes the numbers.

/** The page pauses if the motion has grown beyond this multiple of its first size, because it leaves the picture. */
const GROWTH = 3;

/** Largest number of curves whose names are written above a plot. */
const MOST_NAMED = 10;

/** Number of frames between two updates of the numbers; faster changes could not be read. */
const READ = 5;

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
    constructor(motion, data) {
        this.data = data;
        this.motion = motion;
        this.look = new Look(Math.max(data.points.length, data.states.length / 2, 3));
        this.picture = new Picture(document.getElementById("picture"), this.motion, this.look);
        this.timePlot = new Plot(document.getElementById("time-plot"), this.look);
        this.phasePlot = new Plot(document.getElementById("phase-plot"), this.look);
        this.coordinatePlot = new Plot(document.getElementById("picture"), this.look);
        this.limit = GROWTH;
        this.frames = 0;
        this.inSight = true;
        this.choices();
        this.describe();
        this.picture.survey(true);
        this.playing = data.play && !window.matchMedia("(prefers-reduced-motion: reduce)").matches;
        this.controls = new Controls(this);
        this.play(this.playing);
        new ResizeObserver(() => this.redraw()).observe(document.body);
        new IntersectionObserver((entries) => (this.inSight = entries[entries.length - 1].isIntersecting)).observe(document.querySelector("main"));
        requestAnimationFrame((now) => this.frame(now));
    }

    /** Fill the list of quantities for the plot over time. */
    choices() {
        const { energies, kept } = this.data;
        const several = this.data.zero ? "energies above the least V" : "energies over time";
        const named = [
            ["energies", energies.length > 1 ? several : "energy over time"],
            ["drift", kept ? "energy drift over time" : "change of the energy over time"],
            ["coordinates", "coordinates over time"],
        ];
        const select = document.getElementById("over-time");
        named.slice(energies.length ? 0 : 2, this.data.states.length ? 3 : 2).forEach(([value, text]) => select.append(new Option(text, value)));
        select.addEventListener("change", () => this.redraw());
        document.getElementById("phase").addEventListener("change", () => this.redraw());
        write("drift-name", kept ? "energy drift" : "energy change");
    }

    /** Describe the pictures in words, for screen readers. */
    describe() {
        const { name, points, corners, dimension } = this.data;
        const named = points.filter((_, point) => !corners[point]);
        const what = dimension ? (named.length ? `the points ${named.join(", ")}` : "bodies") : "the coordinates over time";
        const say = (id, text) => document.getElementById(id).setAttribute("aria-label", text);
        say("picture", `Moving picture of ${name}: ${what}`);
        say("time-plot", `Plot over time of ${name}`);
        say("phase-plot", `Phase plane of ${name}: a coordinate and its velocity`);
    }

    /** Play, or pause if `wanted` is false. A motion that has ended begins again. */
    play(wanted) {
        if (wanted && this.motion.ended) {
            this.motion.restart();
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
        write("play", this.playing ? "Pause" : "Play");
        this.redraw();
    }

    step(sign) {
        this.play(false);
        this.motion.step(sign, this.speed);
        this.redraw();
    }

    seek(frame) {
        this.motion.seek(frame);
        this.redraw();
    }

    reset() {
        this.motion.restart();
        this.changed();
    }

    /** Begin again with the present values of the sliders. */
    changed() {
        this.limit = GROWTH;
        this.picture.survey(false);
        this.goOn();
    }

    redraw() {
        this.stale = true;
    }

    /** Advance the motion by `seconds` on the screen, and pause if it has ended or leaves the picture. */
    pass(seconds) {
        if (!this.motion.go(seconds * this.speed)) {
            this.wanted = this.wanted && Boolean(this.motion.said);
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
        if (this.playing && this.inSight) {
            this.pass(seconds);
            this.stale = true;
        }
        if (this.stale && this.inSight) {
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
        if (motion.cursor < 0) {
            return;
        }
        const now = motion.now();
        if (this.data.dimension) {
            this.picture.draw(now.places, this.playing ? 0.08 : 1);
        } else {
            this.overTime(this.coordinatePlot, "coordinates");
        }
        // While time advances, each plot is drawn in every second frame.
        if (!this.playing || this.frames % 2 === 0) {
            this.overTime(this.timePlot, document.getElementById("over-time").value);
        }
        if (motion.size > 0 && (!this.playing || this.frames % 2 === 1)) {
            this.phasePlot.phase(motion, Number(document.getElementById("phase").value), now.y);
        }
    }

    /** Draw the chosen quantity over time. */
    overTime(plot, what) {
        const { motion, look, data } = this;
        const { size } = motion;
        const time = data.unit.t ? `t (${data.unit.t})` : "t";
        const bounds = (from, to) =>
            around(Math.min(...motion.low.slice(from, to)), Math.max(...motion.high.slice(from, to)), from === size ? data.energySize : 0);
        let [rows, limits, unit] = [[], [], ""];
        if (what === "coordinates") {
            rows = data.states.slice(0, size / 2).map((state, k) => ({
                name: withUnit(state),
                colour: look.colours[k],
                value: (at) => motion.states[at * size + k],
            }));
            limits = bounds(0, size / 2);
        } else if (what === "drift") {
            const [letter] = data.energies;
            rows = [
                {
                    name: data.kept ? `(${letter} − ${letter}₀) relative` : `change of ${letter}`,
                    colour: look.ink,
                    value: (at) => motion.drifts[at],
                },
            ];
            limits = (data.kept ? aboutZero : around)(motion.low[size + 3], motion.high[size + 3]);
        } else {
            const colours = [look.ink, look.colours[0], look.colours[1]];
            rows = data.energies.map((name, k) => ({ name, colour: colours[k], value: (at) => motion.energies[at * 3 + k] }));
            limits = bounds(size, size + rows.length);
            unit = data.unit.energy && `in ${data.unit.energy}`;
        }
        plot.overTime(motion, rows, limits, [time, unit]);
        plot.names(rows.length <= MOST_NAMED ? rows : []);
    }

    /** Report in a sentence why the motion stopped, or that it leaves the picture. */
    say() {
        const left = this.picture.left(this.limit) ? "The motion leaves the picture: play goes on, reset begins again." : "";
        write("said", this.motion.said || left);
        document.getElementById("said").classList.toggle("calm", !this.motion.said);
    }

    /** Write the numbers beside the picture: time, energy and its drift. */
    tell() {
        const { motion, data } = this;
        const clock = `${steady(motion.now().t[0], data.decimals)} ${data.unit.t}`.trim();
        write("time", clock);
        this.controls.tell(clock);
        const at = motion.slot(Math.max(0, motion.cursor));
        const energy = motion.cursor < 0 ? NaN : motion.energies[at * 3];
        write("energy", Number.isFinite(energy) ? shown(energy, 6) : "no value");
        const drift = data.kept ? motion.drift : energy - motion.begun;
        write("drift", Number.isFinite(drift) ? shown(drift, data.kept ? 2 : 4) : "no value");
    }
}

/** Set the text of an element only if it changes, so that screen readers do not announce it again. */
function write(id, text) {
    const element = document.getElementById(id);
    if (element && element.textContent !== text) {
        element.textContent = text;
    }
}
