// Calls of an exported right-hand side, each at a state that waits for the slopes before, as the stages of an integrator do.
// node exported_calls.mjs MODULE COUNT prints nanoseconds a call, the least of several rounds.

const model = await import(process.argv[2]);
const count = Number(process.argv[3]);
const start = process.argv.slice(4).map(Number);

const p = new Float64Array(model.PREPARED);
if (model.prepare(model.default_parameters, p)) throw new Error("a matrix is singular");
const y = new Float64Array(start);
const slope = new Float64Array(start.length);

function waiting() {
    for (let k = 0; k < y.length; k++) y[k] = start[k];
    let failed = false;
    for (let i = 0; i < count; i++) {
        failed = model.rhs(0.0, y, p, slope) || failed;
        for (let k = 0; k < y.length; k++) y[k] += 1e-20 * slope[k];
    }
    return failed;
}

let best = Infinity;
for (let round = 0; round < 12; round++) {
    const before = process.cpuUsage().user;
    waiting();
    best = Math.min(best, (process.cpuUsage().user - before) * 1000 / count);
}
console.log(best);
