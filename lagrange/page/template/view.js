// Project positions in the plane or in space to pixels, and choose the visible region.

/** Margin on each side of the motion, as a fraction of the picture. */
const MARGIN = 0.1;

/** Least side of the box around a motion in space, and margin beside the motion, as fractions of its largest side. */
const LEAST_SIDE = 0.25;
const BESIDE = 0.06;

/** A motion in space that has less than this fraction of its size in one direction is viewed along this direction. */
const FLAT = 1e-9;

class View {
    /** Store the `dimension` of positions, 2 or 3. Space is viewed from an azimuth and an elevation in radians. */
    constructor(dimension, [azimuth, elevation]) {
        this.dimension = dimension;
        this.azimuth = azimuth;
        this.elevation = elevation;
        this.box = null;
        this.shown = null;
        this.samples = [];
        this.turn(0, 0);
    }

    /** Rotate the direction of view in space by two angles in radians, across and up. */
    turn(across, up) {
        this.azimuth -= across;
        this.elevation = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, this.elevation + up));
        const [a, e] = [this.azimuth, this.elevation];
        this.right = [-Math.sin(a), Math.cos(a), 0];
        this.up = [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)];
        if (this.samples.length > 0) {
            this.enclose(this.samples);
            this.shown = { ...this.box };
        }
    }

    /** Return the projection of a position: coordinates to the right, and up. */
    seen(places, at) {
        const [x, y] = [places[at], places[at + 1]];
        if (this.dimension === 2) {
            return [x, y];
        }
        const z = places[at + 2];
        const { right, up } = this;
        return [right[0] * x + right[1] * y + right[2] * z, up[0] * x + up[1] * y + up[2] * z];
    }

    /** Set the box from the positions of a run. If `first`, choose the direction of view for a flat motion, too. */
    survey(samples, first) {
        this.samples = samples;
        this.bounds = extents(samples, this.dimension);
        if (first && this.dimension === 3) {
            this.face();
        }
        this.enclose(samples);
        if (first || this.shown === null) {
            this.shown = { ...this.box };
        }
    }

    /** View a motion that stays in a plane of two axes at right angles to this plane. */
    face() {
        const sizes = this.bounds.map(([low, high]) => high - low);
        const flat = sizes.indexOf(Math.min(...sizes));
        if (sizes[flat] <= FLAT * Math.max(...sizes)) {
            const sides = [[0, 0], [-Math.PI / 2, 0], [-Math.PI / 2, Math.PI / 2]];
            [this.azimuth, this.elevation] = sides[flat];
            this.turn(0, 0);
        }
    }

    /** Extend the box to all positions. */
    enclose(samples) {
        this.box = { left: Infinity, right: -Infinity, low: Infinity, high: -Infinity };
        samples.forEach((places) => this.include(places));
        if (this.dimension === 3) {
            const [xs, ys, zs] = this.room;
            xs.forEach((x) => ys.forEach((y) => this.include([x, y, zs[0]])));
            this.include([...this.left, zs[1]]);
        }
        const { left, right, low, high } = this.box;
        if (!(Math.max(right - left, high - low) > 0)) {
            const [u, v] = left <= right ? [left, low] : [0, 0];
            const half = 0.5 * Math.max(Math.abs(u), Math.abs(v)) || 1;
            this.box = { left: u - half, right: u + half, low: v - half, high: v + half };
        }
        this.first = Math.max(this.box.right - this.box.left, this.box.high - this.box.low);
    }

    /** Return the bounds of the box around a motion in space; its floor is at the lowest point. */
    get room() {
        const bounds = this.bounds.map(([low, high]) => (low <= high ? [low, high] : [-1, 1]));
        const largest = Math.max(...bounds.map(([low, high]) => high - low)) || 1;
        return bounds.map(([low, high], k) => {
            const half = Math.max(high - low, LEAST_SIDE * largest) / 2 + BESIDE * largest;
            const middle = k === 2 ? low + half : (low + high) / 2;
            return [middle - half, middle + half];
        });
    }

    /** Corner of the floor that is nearest to the viewer. */
    get near() {
        const [a, e] = [this.azimuth, Math.sign(this.elevation) || 1];
        return [this.room[0][e * Math.cos(a) > 0 ? 1 : 0], this.room[1][e * Math.sin(a) > 0 ? 1 : 0]];
    }

    /** Corner of the floor that is farthest to the left in the picture. */
    get left() {
        const [xs, ys] = this.room;
        return [xs[this.right[0] > 0 ? 0 : 1], ys[this.right[1] > 0 ? 0 : 1]];
    }

    /** Return the direction on the screen in which the numbers of axis number `k` are written beside its edge. */
    outwards(k) {
        if (k === 2) {
            return [-1, 0];
        }
        const other = 1 - k;
        const sign = this.near[other] > (this.room[other][0] + this.room[other][1]) / 2 ? 1 : -1;
        const away = [sign * this.right[other], -sign * this.up[other]];
        const length = Math.hypot(...away) || 1;
        return away.map((part) => part / length);
    }

    /** Extend the box to the positions `places` of all points at one time. */
    include(places) {
        for (let at = 0; at < places.length; at += this.dimension) {
            const [u, v] = this.seen(places, at);
            this.box.left = Math.min(this.box.left, u);
            this.box.right = Math.max(this.box.right, u);
            this.box.low = Math.min(this.box.low, v);
            this.box.high = Math.max(this.box.high, v);
        }
    }

    /** Growth of the box since the start, as a factor. */
    growth() {
        return Math.max(this.box.right - this.box.left, this.box.high - this.box.low) / this.first;
    }

    /** Move the visible region by the fraction `share` of the way to the box, and fit it into a canvas. */
    fit(width, height, share) {
        for (const side of Object.keys(this.box)) {
            this.shown[side] += share * (this.box[side] - this.shown[side]);
        }
        const { left, right, low, high } = this.shown;
        const free = 1 - 2 * MARGIN;
        this.scale = Math.min((free * width) / Math.max(right - left, 1e-300), (free * height) / Math.max(high - low, 1e-300));
        this.scale = Math.min(this.scale, 1e300);
        this.middle = [(left + right) / 2, (low + high) / 2];
        this.centre = [width / 2, height / 2];
    }

    /** Return the pixel of a projected position. */
    pixel([u, v]) {
        return [this.centre[0] + this.scale * (u - this.middle[0]), this.centre[1] - this.scale * (v - this.middle[1])];
    }

    /** Return the pixel of the position that begins at index `at` of `places`. */
    at(places, at) {
        return this.pixel(this.seen(places, at));
    }
}

/** Return the least and the largest coordinate of positions in each direction. */
function extents(samples, dimension) {
    const found = Array.from({ length: dimension }, () => [Infinity, -Infinity]);
    for (const places of samples) {
        places.forEach((value, k) => {
            const bounds = found[k % dimension];
            bounds[0] = Math.min(bounds[0], value);
            bounds[1] = Math.max(bounds[1], value);
        });
    }
    return found;
}
