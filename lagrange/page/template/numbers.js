// Write numbers as text, and choose the tick marks and the limits of an axis.

/** Return a number as text with `digits` digits; small and large ones have a power of ten, as in 3.1·10⁻¹³. */
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

/** Return a whole number as a superscript. */
function raised(power) {
    const marks = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
    return Array.from(String(power), (mark) => marks[mark]).join("");
}

/** Return a number with a fixed number of decimals, so that its width is constant. */
function steady(value, places) {
    return value.toFixed(places).replace("-", "−");
}

/** Return the distance between tick marks for an axis with this `length` and at most `most` tick marks. */
function markDistance(length, most) {
    const least = length / most;
    const unit = 10 ** Math.floor(Math.log10(least));
    return unit * [1, 2, 5, 10].find((first) => least <= first * unit * (1 + 1e-9));
}

/** Return at most `most` tick marks between two limits, their labels, and the power of ten that they have in common. */
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

/**
 * Return the limits of an axis, with a margin, for values from `low` to `high`. Values that differ only by rounding
 * noise, relative to the values or to `scale`, are in the middle of the axis.
 */
function around(low, high, scale = 0) {
    if (!(low <= high)) {
        return [-1, 1];
    }
    const size = Math.max(Math.abs(low), Math.abs(high), scale);
    const half = high - low > 1e-9 * size ? 0.56 * (high - low) : 0.5 * size || 1;
    return [(low + high) / 2 - half, (low + high) / 2 + half];
}

/** Return limits symmetric about zero for the axis of a drift: a power of ten, or half of a power of ten. */
function aboutZero(low, high) {
    const largest = Math.max(Math.abs(low), Math.abs(high)) || 1e-16;
    const power = 10 ** Math.ceil(Math.log10(largest));
    const end = largest < power / 2 ? power / 2 : power;
    return [-end, end];
}

/** Interpolate linearly between two numbers; `share` = 1 returns the second one exactly. */
function part(from, to, share) {
    return share === 1 ? to : from + share * (to - from);
}
