// The moving picture: a grid or a floor, trails, surfaces, rods, springs and points.

/** Width of a spring as a fraction of the smaller side of the picture, and its least width in pixels. */
const SPRING = 0.044;
const LEAST_SPRING = 10;

/** Number of parts of a trail with different opacities; the oldest part is the palest. */
const BANDS = 16;

/** Largest number of line segments of a trail. */
const PARTS = 2400;

/** Least length in pixels of an axis of space that has numbers. */
const SHORTEST_AXIS = 30;

/** Time in ms for which the run is computed ahead: once after values change, and in each frame. */
const LOOK_AHEAD = 25;
const LOOK_ON = 4;

class Picture {
    constructor(canvas, motion, look) {
        this.canvas = canvas;
        this.motion = motion;
        this.look = look;
        this.data = motion.data;
        this.view = new View(motion.data.dimension || 2, motion.data.view);
        this.trail = 0;
    }

    /** Begin to compute the run ahead for new values of the sliders. `first` is true when the page opens. */
    survey(first) {
        this.ahead = this.motion.survey();
        this.first = first;
        this.surveyed = false;
        this.lookAhead(LOOK_AHEAD);
    }

    /** Compute the run further ahead for `time` ms, and fit the picture to its positions. */
    lookAhead(time) {
        if (this.surveyed) {
            return;
        }
        this.surveyed = this.ahead.until(performance.now() + time);
        const samples = this.ahead.found;
        if (samples.length > 0 || this.first) {
            this.view.survey(this.withOrigin(samples), this.first);
        }
        this.first = false;
    }

    /** True if the motion leaves the picture: it has grown beyond `limit` times the size of the run computed ahead. */
    left(limit) {
        return this.surveyed && this.data.dimension > 0 && this.view.growth() >= limit;
    }

    /** Return positions, with the origin added if a link ends at it. */
    withOrigin(samples) {
        return this.linked() ? [...samples, new Float64Array(this.data.dimension)] : samples;
    }

    linked() {
        const last = this.data.points.length;
        return this.data.links.some(([a, b]) => a === last || b === last);
    }

    /** True if a point never moves. Such a point has no colour of its own. */
    fixed(point) {
        return this.data.colours[point] === null;
    }

    /**
     * Draw the picture with the points at `places`. If the motion leaves the visible region, the region moves by the
     * fraction `share` of the way to the new one.
     */
    draw(places, share) {
        const { context, width, height } = sized(this.canvas);
        const { view } = this;
        view.include(places);
        view.fit(width, height, share);
        context.lineJoin = context.lineCap = "round";
        if (view.dimension === 3) {
            this.drawFloor(context, places);
        } else {
            this.drawGrid(context, width, height);
        }
        this.drawTrails(context, places);
        const origin = new Float64Array(this.data.dimension);
        const end = (point) => (point === this.data.points.length ? view.at(origin, 0) : view.at(places, point * this.data.dimension));
        this.drawSurfaces(context, places, Math.min(width, height));
        this.drawLinks(context, end, Math.min(width, height));
        this.drawPoints(context, end, Math.min(width, height));
    }

    drawGrid(context, width, height) {
        const { view, look } = this;
        const [middle, scale] = [view.middle, view.scale];
        const rows = [[middle[0] - width / 2 / scale, middle[0] + width / 2 / scale], [middle[1] - height / 2 / scale, middle[1] + height / 2 / scale]];
        const distance = markDistance(Math.min(width, height) / scale, 5);
        context.font = look.font;
        context.lineWidth = 1;
        rows.forEach(([low, high], axis) => {
            const found = marks(low, high, (high - low) / distance);
            found.places.forEach((value, k) => {
                const [x, y] = view.pixel(axis === 0 ? [value, 0] : [0, value]);
                context.strokeStyle = look.grid;
                context.beginPath();
                context.moveTo(axis === 0 ? x : 0, axis === 0 ? 0 : y);
                context.lineTo(axis === 0 ? x : width, axis === 0 ? height : y);
                context.stroke();
                context.fillStyle = look.quiet;
                context.textAlign = axis === 0 ? "center" : "left";
                context.textBaseline = axis === 0 ? "bottom" : "middle";
                const inside = axis === 0 ? x > 34 && x < width - 20 : y > 12 && y < height - 26;
                if (inside) {
                    context.fillText([found.texts[k], found.factor].filter(Boolean).join("·"), axis === 0 ? x : 7, axis === 0 ? height - 5 : y);
                }
            });
        });
        const unit = this.data.unit.length;
        context.textAlign = "right";
        context.textBaseline = "bottom";
        context.fillText(unit ? `x, y in ${unit}` : "", width - 8, height - 22);
    }

    /** Draw the floor under a motion in space, the numbers at its edges, a vertical axis, and shadows of the points. */
    drawFloor(context, places) {
        const { view, look } = this;
        const { room, near, left } = view;
        const pixel = (place) => view.pixel(view.seen(place, 0));
        const line = (from, to, colour) => {
            context.strokeStyle = colour;
            context.beginPath();
            context.moveTo(...pixel(from));
            context.lineTo(...pixel(to));
            context.stroke();
        };
        context.lineWidth = 1;
        context.font = look.font;
        context.fillStyle = look.quiet;
        context.textAlign = "center";
        context.textBaseline = "middle";
        const unit = this.data.unit.length;
        const feet = [[null, near[1]], [near[0], null], left];
        "xyz".split("").forEach((name, k) => {
            const at = (value, end) => [0, 1, 2].map((i) => (i === k ? value : i === 2 ? room[2][0] : end ?? feet[k][i]));
            const [begin, end] = room[k].map((value) => pixel(at(value)));
            const length = Math.hypot(end[0] - begin[0], end[1] - begin[1]);
            if (length < SHORTEST_AXIS) {
                return; // the axis is seen from its end
            }
            const away = view.outwards(k);
            const { places: ticks, texts, factor } = marks(...room[k], Math.min(4, length / 40));
            if (k < 2) {
                ticks.forEach((value) => line(at(value, room[1 - k][0]), at(value, room[1 - k][1]), look.grid));
                room[1 - k].forEach((side) => line(at(room[k][0], side), at(room[k][1], side), look.quiet));
            } else {
                line(at(room[2][0]), at(room[2][1]), look.quiet);
            }
            const write = (text, [x, y], far) => {
                const half = context.measureText(text).width / 2 + 2; // a text at the left edge is not cut
                context.fillText(text, Math.max(half, x + far * away[0]), Math.max(8, y + far * away[1]));
            };
            ticks.forEach((value, n) => write(texts[n], pixel(at(value)), k < 2 ? 13 : 18));
            const label = [unit ? `${name} (${unit})` : name, factor].filter(Boolean).join(" in ");
            const [x, y] = pixel(at(k < 2 ? (room[k][0] + room[k][1]) / 2 : room[2][1]));
            write(label, k < 2 ? [x, y] : [x, y - 10], [32, 40, 0][k]);
        });
        context.globalAlpha = 0.35;
        for (let at = 0; at < 3 * this.data.points.length; at += 3) {
            if (this.data.corners[at / 3]) {
                continue;
            }
            const [x, y] = pixel([places[at], places[at + 1], room[2][0]]);
            context.beginPath();
            context.ellipse(x, y, 6, Math.max(1, 6 * Math.abs(Math.sin(view.elevation))), 0, 0, 2 * Math.PI);
            context.fill();
        }
        context.globalAlpha = 1;
    }

    drawTrails(context, places) {
        const { motion, view, look } = this;
        const { dimension } = this.data;
        const last = motion.cursor;
        const length = Math.min(Math.round(this.trail * motion.perSecond), last + 1 - motion.known[0]);
        if (length < 1) {
            return;
        }
        const stride = Math.max(1, Math.ceil(length / PARTS));
        const first = Math.ceil((last + 1 - length) / stride) * stride;
        context.lineWidth = 1.6;
        this.data.points.forEach((_, point) => {
            if (this.fixed(point) || this.data.corners[point]) {
                return;
            }
            context.strokeStyle = look.colours[this.data.colours[point]];
            const pixel = (k) => view.at(motion.places, motion.slot(k) * motion.width + point * dimension);
            const band = Math.max(stride, Math.ceil(length / BANDS / stride) * stride);
            for (let begin = first; begin <= last; begin += band) {
                const end = Math.min(begin + band, last);
                context.globalAlpha = 0.08 + 0.72 * ((begin - first) / length) ** 1.5;
                context.beginPath();
                context.moveTo(...pixel(begin));
                for (let k = begin + stride; k < end; k += stride) {
                    context.lineTo(...pixel(k));
                }
                context.lineTo(...pixel(end));
                if (end === last) {
                    context.lineTo(...view.at(places, point * dimension));
                }
                context.stroke();
            }
        });
        context.globalAlpha = 1;
    }

    drawSurfaces(context, places, size) {
        const { dimension, surfaces } = this.data;
        context.strokeStyle = this.look.ink;
        context.lineWidth = Math.max(2.5, size / 150);
        for (const [first, count] of surfaces) {
            context.beginPath();
            for (let point = first; point < first + count; point++) {
                context.lineTo(...this.view.at(places, point * dimension));
            }
            context.stroke();
        }
    }

    drawLinks(context, end, size) {
        for (const [a, b, kind] of this.data.links) {
            const [from, to] = [end(a), end(b)];
            context.strokeStyle = this.look.ink;
            context.globalAlpha = 0.75;
            context.lineWidth = kind === "rod" ? Math.max(2.5, size / 150) : Math.max(1.5, size / 280);
            context.beginPath();
            context.moveTo(...from);
            if (kind === "spring") {
                drawSpring(context, this.data.spring, from, to, Math.max(LEAST_SPRING, SPRING * size));
            }
            context.lineTo(...to);
            context.stroke();
        }
        context.globalAlpha = 1;
    }

    drawPoints(context, end, size) {
        const { look } = this;
        const radius = this.data.size * Math.min(11, Math.max(6, size / 48));
        const origin = this.data.points.length;
        if (this.data.dimension > 0) {
            const [x, y] = end(origin);
            context.fillStyle = this.linked() ? look.ink : look.quiet;
            const half = this.linked() ? 0.55 * radius : 0.3 * radius;
            context.fillRect(x - half, y - half, 2 * half, 2 * half);
        }
        this.data.points.forEach((_, point) => {
            if (this.data.corners[point]) {
                return;
            }
            const [x, y] = end(point);
            context.fillStyle = this.fixed(point) ? look.ink : look.colours[this.data.colours[point]];
            context.strokeStyle = look.paper;
            context.lineWidth = 2;
            context.beginPath();
            if (this.fixed(point)) {
                context.rect(x - 0.6 * radius, y - 0.6 * radius, 1.2 * radius, 1.2 * radius);
            } else {
                context.arc(x, y, radius, 0, 2 * Math.PI);
            }
            context.fill();
            context.stroke();
        });
    }
}

/**
 * Draw a spring between two pixels. `corners` has its corners as pairs: the fraction of the length along the spring,
 * and the fraction of the width beside it.
 */
function drawSpring(context, corners, from, to, width) {
    const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
    const length = Math.hypot(dx, dy) || 1;
    const [nx, ny] = [(-dy / length) * width, (dx / length) * width];
    for (const [along, aside] of corners) {
        context.lineTo(from[0] + along * dx + aside * nx, from[1] + along * dy + aside * ny);
    }
}

/** Set the resolution of a canvas from its size on the page; return its cleared context and its size in pixels. */
function sized(canvas) {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
    }
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    return { context, width, height };
}
