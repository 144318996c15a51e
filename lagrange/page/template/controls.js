// Handle buttons, keys, and dragging to turn the picture.

/** Degrees by which a press of a key turns the picture. */
const TURN = 5;

/** Selector of the elements that handle keys themselves. */
const OWN_KEYS = "input:not(#seek), select, textarea, summary";

class Controls {
    constructor(player) {
        this.player = player;
        const { motion } = player;
        const on = (id, act) => document.getElementById(id)?.addEventListener("click", act);
        on("play", () => player.play(!player.playing));
        on("step", () => player.step(1));
        on("back", () => player.step(-1));
        on("reset", () => player.reset());
        on("defaults", () => player.sliders.restore());
        on("style", () => this.style());
        on("loop", () => this.setLoop(!motion.loops));
        this.speed = document.getElementById("speed");
        this.speed.addEventListener("input", () => this.setSpeed());
        const trail = document.getElementById("trail");
        const setTrail = () => {
            player.picture.trail = Number(trail.value);
            player.redraw();
        };
        trail.addEventListener("change", setTrail);
        document.addEventListener("keydown", (event) => this.key(event));
        this.dark = window.matchMedia("(prefers-color-scheme: dark)");
        this.dark.addEventListener("change", () => this.named());
        setTrail();
        this.setSpeed();
        this.named();
        if (motion.frames) {
            this.seek = document.getElementById("seek");
            this.seek.max = String(motion.frames - 1);
            this.seek.addEventListener("input", () => this.goTo(Number(this.seek.value)));
        }
        if (motion.data.dimension === 3) {
            this.turning(player.picture.canvas);
        } else {
            player.picture.canvas.addEventListener("click", () => player.play(!player.playing));
        }
    }

    /** Pause at a frame. */
    goTo(frame) {
        this.player.play(false);
        this.player.seek(frame);
    }

    /** Show the present frame and its time. */
    tell(clock) {
        if (this.seek) {
            this.seek.value = String(Math.floor(this.player.motion.place / this.player.motion.detail));
            this.seek.setAttribute("aria-valuetext", clock);
        }
    }

    setLoop(wanted) {
        this.player.motion.loops = wanted;
        document.getElementById("loop").setAttribute("aria-pressed", String(wanted));
    }

    setSpeed() {
        this.player.speed = 2 ** Number(this.speed.value);
        const { speed, data } = this.player;
        const times = speed < 1 ? `× 1/${1 / speed}` : `× ${speed}`;
        const text = Math.abs(data.rate) === 1 ? times : `${shown(Math.abs(data.rate) * speed)} ${data.unit.t}/s`;
        document.getElementById("speed-value").textContent = text;
        this.speed.setAttribute("aria-valuetext", text);
    }

    /** Change between light and dark. */
    style() {
        document.documentElement.dataset.style = this.isDark() ? "light" : "dark";
        this.named();
    }

    isDark() {
        const chosen = document.documentElement.dataset.style;
        return chosen ? chosen === "dark" : this.dark.matches;
    }

    named() {
        write("style", this.isDark() ? "Light" : "Dark");
        this.player.look.read();
        this.player.redraw();
    }

    key(event) {
        if (event.ctrlKey || event.altKey || event.metaKey || event.target.closest?.(OWN_KEYS)) {
            return;
        }
        const { player } = this;
        const { motion } = player;
        const faster = (by) => {
            this.speed.value = String(Number(this.speed.value) + by);
            this.setSpeed();
        };
        const keys = {
            ArrowRight: () => player.step(1),
            r: () => player.reset(),
            k: () => player.play(!player.playing),
            "+": () => faster(1),
            "=": () => faster(1),
            "-": () => faster(-1),
        };
        if (motion.frames) {
            const second = Math.round(motion.perSecond / motion.detail);
            const frame = Math.floor(motion.place / motion.detail);
            Object.assign(keys, {
                ArrowLeft: () => player.step(-1),
                Home: () => player.seek(0),
                End: () => this.goTo(motion.frames - 1),
                PageUp: () => player.seek(frame - second),
                PageDown: () => player.seek(frame + second),
                l: () => this.setLoop(!motion.loops),
            });
        }
        if (!event.target.closest?.("button")) {
            keys[" "] = () => player.play(!player.playing);
        }
        const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
        if (act) {
            event.preventDefault();
            act();
        }
    }

    /** Turn a picture of space by dragging it, or by arrow keys while it has the focus. */
    turning(canvas) {
        const { player } = this;
        const turn = (across, up) => {
            player.picture.view.turn(across, up);
            player.redraw();
        };
        canvas.classList.add("turns");
        canvas.tabIndex = 0;
        document.getElementById("turn-keys")?.removeAttribute("hidden");
        canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
        canvas.addEventListener("pointermove", (event) => {
            if (canvas.hasPointerCapture(event.pointerId)) {
                turn(event.movementX / 120, event.movementY / 120);
            }
        });
        canvas.addEventListener("keydown", (event) => {
            const angle = (TURN * Math.PI) / 180;
            const turns = { ArrowLeft: [-angle, 0], ArrowRight: [angle, 0], ArrowUp: [0, -angle], ArrowDown: [0, angle] };
            if (turns[event.key]) {
                event.preventDefault();
                event.stopPropagation();
                turn(...turns[event.key]);
            }
        });
    }
}
