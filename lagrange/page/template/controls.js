// Buttons, keys, and turning the picture.

/** Degrees by which a press of a key turns the picture. */
const TURN = 5;

/** Elements that handle keys themselves. */
const OWN_KEYS = "input, select, textarea, summary";

class Controls {
    constructor(player) {
        this.player = player;
        const on = (id, act) => document.getElementById(id).addEventListener("click", act);
        on("play", () => player.play(!player.playing));
        on("step", () => player.step());
        on("reset", () => player.reset());
        on("defaults", () => player.sliders.restore());
        on("style", () => this.style());
        this.speed = document.getElementById("speed");
        this.speed.addEventListener("input", () => this.setSpeed());
        const trail = document.getElementById("trail");
        trail.addEventListener("change", () => {
            player.picture.trail = Number(trail.value);
            player.redraw();
        });
        document.addEventListener("keydown", (event) => this.key(event));
        this.dark = window.matchMedia("(prefers-color-scheme: dark)");
        this.dark.addEventListener("change", () => this.named());
        this.setSpeed();
        this.named();
        if (player.motion.data.dimension === 3) {
            this.turning(player.picture.canvas);
        }
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
        document.getElementById("style").textContent = this.isDark() ? "Light" : "Dark";
        this.player.look.read();
        this.player.redraw();
    }

    key(event) {
        if (event.ctrlKey || event.altKey || event.metaKey || event.target.closest(OWN_KEYS)) {
            return;
        }
        const { player } = this;
        const faster = (by) => {
            this.speed.value = String(Number(this.speed.value) + by);
            this.setSpeed();
        };
        const keys = {
            ArrowRight: () => player.step(),
            r: () => player.reset(),
            "+": () => faster(1),
            "=": () => faster(1),
            "-": () => faster(-1),
        };
        if (!event.target.closest("button")) {
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
        document.getElementById("turn-keys").hidden = false;
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
