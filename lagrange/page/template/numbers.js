// Numbers as people read them, and the places of marks on an axis.

/** Return a number with some digits; powers of ten stand behind a dot, as in 3.1·10⁻¹³. */
function shown(value, digits = 4) {
    if (value === 0) {
        return "0";
    }
    const size = Math.abs(value);
    if (size >= 1e-3 && size < 1e5) {
        return String(Number(value.toPrecision(digits))).replace("-", "−");
    }
    const [first, power] = value.toExponential(Math.min(digits - 1, 2)).split("e");
    return `${String(Number(first)).replace("-", "−")}·10${raised(Number(power))}`;
}

/** Return a whole number as an exponent. */
function raised(power) {
    const marks = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
    return Array.from(String(power), (mark) => marks[mark]).join("");
}

/** Return a number with so many places behind the point: it keeps its width while it runs. */
function steady(value, places) {
    return value.toFixed(places).replace("-", "−");
}

/** Return the distance of marks of which an axis of a length has some. */
function markDistance(length, most) {
    const least = length / most;
    const unit = 10 ** Math.floor(Math.log10(least));
    return unit * [1, 2, 5, 10].find((first) => least <= first * unit * (1 + 1e-9));
}

/** Return the marks between two bounds, what is written at each, and the power of ten that all are multiplied by. */
function marks(low, high, most) {
    const distance = markDistance(high - low, most);
    const found = [];
    for (let k = Math.ceil(low / distance - 1e-9); k * distance <= high + 1e-9 * distance; k++) {
        found.push(k * distance);
    }
    const largest = Math.max(...found.map(Math.abs), 0);
    const power = largest > 0 ? Math.floor(Math.log10(largest)) : 0;
    const scale = power >= 5 || power <= -4 ? power : 0;
    const places = Math.max(0, scale - Math.floor(Math.log10(distance) + 1e-9));
    const texts = found.map((value) => steady(value / 10 ** scale, Math.min(places, 12)).replace(/^−(0(\.0*)?)$/, "$1"));
    return { places: found, texts, factor: scale ? `10${raised(scale)}` : "" };
}

/** Return bounds that leave room around values; what stays put gets an axis of its own size. */
function roomy(low, high) {
    if (!(low <= high)) {
        return [-1, 1];
    }
    const size = Math.max(Math.abs(low), Math.abs(high));
    const half = high - low > 1e-9 * size ? 0.56 * (high - low) : 0.5 * size || 1;
    return [(low + high) / 2 - half, (low + high) / 2 + half];
}
