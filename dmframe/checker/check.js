// Checks the certificate of a control loop: node check.js FILE [--json], or checker.check(data) in a browser.
//
// It shares no code with dmframe or with check.py, and is built in another way: program, derivatives, robot and rules
// become one directed graph of sums, products, inverses and functions of symbols. The graph is then evaluated in random
// prime fields, bounded in degree, and evaluated in intervals. docs/explanation/checker.md proves each rule.
//
// Exit status: 0 re-proved, 1 refuted, 2 refused (no valid certificate, or a rule that this program does not know).
globalThis.checker = (() => {
  "use strict";

  class Refused extends Error {}
  class Refuted extends Error {}
  class TooLong extends Refused {}
  const fail = (text) => { throw new Refused(text); };
  const need = (condition, text) => condition || fail(text);
  const refute = (text) => { throw new Refuted(text); };

  const WANTED = -300, SIZES = [149, 269, 521], LARGEST = 1 << 22, BIG = 1n << 20000n;
  const CONSTANT = ["parameter", "weight", "constant", "stepping"];
  const KINDS = [...CONSTANT, "time", "state", "trajectory", "projection", "period", "noise", "command"];
  const BOUNDED = "sin cos tanh atan atan2 sign lt le eq ne not and or erf".split(" ");
  const UNARY = ("sin cos tanh atan sqrt exp log fabs sign floor ceil not tan asin acos sinh cosh asinh acosh atanh erf " +
    "erfinv expm1 log1p").split(" ");
  const CALLS = [...UNARY, ..."pow constpow fmin fmax lt le eq ne and or if_else_zero atan2 hypot copysign fmod remainder".split(" ")];
  const BELIEVED = [
    "signals have the names of the file; its rates and next values are those of the loop that runs",
    "divisors, and arguments of roots and logarithms, stay away from 0",
  ];

  // ---- Rational numbers [numerator, denominator > 0], and intervals [lower, upper] of them

  function fraction(n, d = 1n) {
    if (d < 0n) [n, d] = [-n, -d];
    let [a, b] = [n < 0n ? -n : n, d];
    while (b) [a, b] = [b, a % b];
    if (d / a > BIG || n / a > BIG || n / a < -BIG) throw new TooLong("a number is too long");
    return [n / a, d / a];
  }
  const sum = (x, y) => fraction(x[0] * y[1] + y[0] * x[1], x[1] * y[1]);
  const product = (x, y) => fraction(x[0] * y[0], x[1] * y[1]);
  const less = (x, y) => x[0] * y[1] < y[0] * x[1];
  const least = (all) => all.reduce((x, y) => (less(y, x) ? y : x));
  const most = (all) => all.reduce((x, y) => (less(x, y) ? y : x));
  const positive = (x) => x[0] > 0n;
  const minusOne = [-1n, 1n], zeroQ = [0n, 1n];
  const plusI = (a, b) => [sum(a[0], b[0]), sum(a[1], b[1])];
  const timesI = (a, b, same) => {
    const ends = a.flatMap((x) => b.map((y) => product(x, y)));
    return [same ? most([zeroQ, least(ends)]) : least(ends), most(ends)];
  };
  const minusI = (a, b) => plusI(a, timesI([minusOne, minusOne], b));
  const inverseI = (a) => (positive(a[0]) || a[1][0] < 0n ? [fraction(a[1][1], a[1][0]), fraction(a[0][1], a[0][0])] : null);

  // All symmetric matrices in these intervals are positive definite if all pivots are.
  function definite(rows) {
    while (rows.length) {
      const [first, ...rest] = rows, pivot = first[0];
      if (!positive(pivot[0])) return false;
      rows = rest.map((row) => {
        const factor = timesI(row[0], inverseI(pivot));
        return row.slice(1).map((x, k) => minusI(x, timesI(factor, first[k + 1])));
      });
    }
    return true;
  }

  function rational(text) {
    need(typeof text === "string" && text.length < 4000 && /^-?\d+(\/0*[1-9]\d*)?$/.test(text), `expected a fraction, found ${text}`);
    const [n, d] = text.split("/");
    return fraction(BigInt(n), BigInt(d ?? 1));
  }

  // ---- The graph: node k has an operation and operands below k

  const [NUMBER, INPUT, ADD, SUB, MUL, INV, CALL] = [0, 1, 2, 3, 4, 5, 6], ZERO = 0, ONE = 1, NONE = -1;

  class Graph {
    op = []; a = []; b = []; numbers = []; known = new Map();
    constructor() { this.number(zeroQ); this.number([1n, 1n]); }
    node(op, a, b = 0) {
      const key = (op * LARGEST + a) * LARGEST + b;
      let k = this.known.get(key);
      if (k === undefined) {
        k = this.op.length;
        need(k < LARGEST, "the certificate is too large");
        this.known.set(key, k);
        this.op.push(op); this.a.push(a); this.b.push(b);
      }
      return k;
    }
    number(q) {
      const text = q.join("/"), at = this.known.get(text) ?? this.numbers.push(q) - 1;
      this.known.set(text, at);
      return this.node(NUMBER, at);
    }
    input(symbol, element) { return this.node(INPUT, symbol, element); }
    add(x, y) { return x === ZERO ? y : y === ZERO ? x : this.node(ADD, Math.min(x, y), Math.max(x, y)); }
    sub(x, y) { return y === ZERO ? x : x === y ? ZERO : this.node(SUB, x, y); }
    mul(x, y) {
      if (x === ZERO || y === ZERO) return ZERO;
      return x === ONE ? y : y === ONE ? x : this.node(MUL, Math.min(x, y), Math.max(x, y));
    }
    inv(x) { return x === ONE ? ONE : this.node(INV, x); }
    div(x, y) { return this.mul(x, this.inv(y)); }
    neg(x) { return this.sub(ZERO, x); }
    call(name, x, y = 0) {
      if (name === "if_else_zero" && x <= ONE) return x ? y : ZERO;
      if (name === "not" && x === ZERO) return ONE;
      return this.node(CALL + CALLS.indexOf(name), x, UNARY.includes(name) ? 0 : y);
    }
    power(x, n) {
      let value = ONE;
      for (let k = 0; k < Math.abs(n); k++) value = this.mul(value, x);
      return n < 0 ? this.inv(value) : value;
    }
    name(k) { return this.op[k] < CALL ? "" : CALLS[this.op[k] - CALL]; }
    operands(k) {
      const op = this.op[k];
      if (op <= INPUT) return [];
      return op === INV || UNARY.includes(this.name(k)) ? [this.a[k]] : [this.a[k], this.b[k]];
    }
    // The nodes that these depend on, in their order.
    slice(nodes) {
      const marked = new Uint8Array(this.op.length), found = [];
      for (const k of nodes) marked[k] = 1;
      for (let k = marked.length - 1; k >= 0; k--) {
        if (!marked[k]) continue;
        found.push(k);
        for (const x of this.operands(k)) marked[x] = 1;
      }
      return found.reverse();
    }
    // The symbols that these depend on.
    reads(nodes) { return new Set(this.slice(nodes).filter((k) => this.op[k] === INPUT).map((k) => this.a[k])); }
    built(k, x, y) {
      const op = this.op[k];
      if (op === ADD) return this.add(x, y);
      if (op === SUB) return this.sub(x, y);
      if (op === MUL) return this.mul(x, y);
      return op === INV ? this.inv(x) : op < CALL ? k : this.call(this.name(k), x, y);
    }
    // The same nodes with other inputs.
    replaced(nodes, input) {
      const found = new Map();
      for (const k of this.slice(nodes)) {
        found.set(k, this.op[k] === INPUT ? input(k) : this.built(k, ...this.operands(k).map((x) => found.get(x))));
      }
      return nodes.map((k) => found.get(k));
    }
    // Derivatives, from those of the inputs; NONE where there is none.
    rates(nodes, moves, found) {
      const plus = (x, y) => (x === NONE || y === NONE ? NONE : this.add(x, y));
      const scaled = (factor, x) => (x === NONE ? NONE : this.mul(factor, x));
      for (const k of this.slice(nodes)) {
        if (found.has(k)) continue;
        const [x, y] = this.operands(k), dx = found.get(x), dy = found.get(y), op = this.op[k];
        let rate = ZERO;
        if (op === INPUT) rate = moves(k);
        else if (op === ADD) rate = plus(dx, dy);
        else if (op === SUB) rate = plus(dx, scaled(this.neg(ONE), dy));
        else if (op === MUL) rate = plus(scaled(y, dx), scaled(x, dy));
        else if (op === INV) rate = scaled(this.neg(this.mul(k, k)), dx);
        else if (op >= CALL && (dx !== ZERO || (dy ?? ZERO) !== ZERO)) {
          const slope = this.slope(this.name(k), k, x);
          rate = slope === NONE ? NONE : scaled(slope, dx);
        }
        found.set(k, rate);
      }
      return nodes.map((k) => found.get(k));
    }
    slope(name, k, x) {
      if (name === "sin") return this.call("cos", x);
      if (name === "cos") return this.neg(this.call("sin", x));
      if (name === "tanh") return this.sub(ONE, this.mul(k, k));
      if (name === "atan") return this.inv(this.add(ONE, this.mul(x, x)));
      if (name === "sqrt") return this.inv(this.add(k, k));
      return name === "exp" ? k : name === "log" ? this.inv(x) : NONE;
    }
    dot(x, y) {
      need(x.length === y.length, "vectors of different lengths");
      return x.reduce((total, a, k) => this.add(total, this.mul(a, y[k])), ZERO);
    }
    minus(x, y) {
      need(x.length === y.length, "vectors of different lengths");
      return x.map((a, k) => this.sub(a, y[k]));
    }
    total(x) { return x.reduce((a, b) => this.add(a, b), ZERO); }
    matmul(X, Y) { return X.map((row) => Y[0].map((_, j) => this.dot(row, Y.map((line) => line[j])))); }
    // X^-1 Y
    solve(X, Y) {
      let rows = X.map((row, i) => [...row, ...Y[i]]);
      for (let k = 0; k < X.length; k++) {
        const pivot = this.inv(rows[k][k]), own = rows[k].map((x) => this.mul(x, pivot));
        rows = rows.map((row, i) => (i === k ? own : row.map((x, j) => this.sub(x, this.mul(row[k], own[j])))));
      }
      return rows.map((row) => row.slice(X.length));
    }
  }

  const spread = (item, size) => {
    need(item.length === 1 || item.length === size, "expected one number, or one for each element");
    return item.length === size ? item : Array(size).fill(item[0]);
  };
  const matrix = (flat, rows) => Array.from({ length: rows }, (_, i) => flat.filter((_, k) => k % rows === i));
  const transposed = (rows) => rows[0].map((_, j) => rows.map((row) => row[j]));

  // ---- The file

  const TOP = "format version about over symbols numbers program vectors rates terms";
  const LISTS = { // keys, and those that may be missing
    cross: ["term by", ""], projections: ["term state correction set true", "lower upper"],
    masses: ["weight position translations inertia rotors joints motion", ""], linear: ["vectors rates", ""],
    ranks: ["name matrix", ""], conditions: ["name", "margin strict"],
    conclusions: ["signal says", "assumes vector estimate"], steps: ["rule estimate memory sizes rows box parts", ""],
    lines: ["state newest before when", ""], plant: ["momentum rest", ""],
  };
  const PARTS = {
    square: "vector weight", monotone: "weight first second scale", potential: "vector width weight",
    gathered: "vector weight memory regressor by forgetting", log_det: "matrix true weight",
  };
  const ROLES = {
    stored: ["square", "gathered", "potential", "log_det"], dissipated: ["square", "monotone", "gathered"],
    residual: ["square"], cross: ["square"],
  };

  function keys(item, text, names, optional = "") {
    const [must, may] = [names, optional].map((x) => x.split(" "));
    const wrong = [...Object.keys(item).filter((x) => !must.includes(x) && !may.includes(x)), ...must.filter((x) => x && !Object.hasOwn(item, x))];
    need(!wrong.length, `${text}: missing or unknown: ${wrong}`);
    return item;
  }
  const whole = (x, from, to, text) => {
    need(Number.isSafeInteger(x) && from <= x && x < to, `${text}: expected a whole number in [${from}, ${to})`);
    return x;
  };
  const list = (x, text) => (Array.isArray(x) ? x : fail(`${text}: expected a list`));

  class Certificate {
    constructor(data) {
      keys(data, "the file", TOP, `${Object.keys(LISTS).join(" ")} assumed between solved`);
      need(data.format === "dmframe-certificate" && data.version === 1, "expected a dmframe-certificate of version 1");
      need(data.over === "flow" || data.over === "sample", "over: expected flow or sample");
      this.samples = data.over === "sample";
      this.graph = new Graph();
      this.symbols = list(data.symbols, "symbols").map((item) => keys(item, "a symbol", "label kind size", "values"));
      this.places = new Map(this.symbols.map((item, k) => [item.label, k]));
      need(this.places.size === this.symbols.length, "a symbol: found twice");
      this.known = new Map(); // intervals of input nodes
      this.fixed = this.symbols.filter((item) => item.values).map((item) => item.label);
      for (const item of this.symbols) this.readSymbol(item);
      for (const [label, values] of Object.entries(data.numbers)) this.readNumbers(this.symbol(label), values);
      const nodes = this.readProgram(keys(data.program, "program", "operations code a b constants"));
      this.rows = [];
      this.vectors = list(data.vectors, "vectors").map(([rows, elements]) => {
        need(!elements.length || elements.length % whole(rows, 1, LARGEST, "rows") === 0, "a vector");
        this.rows.push(rows);
        return elements.map((x) => (whole(x, -1, nodes.length, "a vector") < 0 ? ZERO : nodes[x]));
      });
      for (const [name, [must, may]] of Object.entries(LISTS)) {
        this[name] = list(data[name] ?? [], name).map((item) => keys(item, name, must, may));
      }
      const absent = this.samples ? ["cross", "projections", "masses", "linear", "ranks"] : ["steps", "lines", "plant", "solved", "between"];
      for (const name of absent) need(!Object.keys(data[name] ?? {}).length, `${name}: not known over a ${data.over}`);
      this.assumed = data.assumed ?? [];
      this.solved = data.solved ?? [];
      this.moves = this.readRates(data.rates);
      this.between = this.readRates(data.between ?? {});
      this.terms = list(data.terms, "terms").map((item) => this.readTerm(item));
      this.derivatives = new Map();
      const stored = this.terms.filter((item) => item.role === "stored").flatMap((item) => Object.values(item.parts));
      need(stored.length || this.steps.length, "V has no term");
      this.constant(stored.flatMap((k) => this.vector(k)), "V", true);
    }
    readSymbol(item) {
      whole(item.size, 0, LARGEST, "the size of a symbol");
      need(typeof item.label === "string" && KINDS.includes(item.kind), `${item.label}: of an unknown kind`);
      need(item.size === 1 || !["time", "weight", "period"].includes(item.kind), `${item.label}: expected one number`);
      if (item.values) this.readNumbers(item, item.values);
    }
    readNumbers(item, values) {
      const found = list(values, item.label).map((x) => (Array.isArray(x) ? x : [x, x]).map(rational));
      need(item.kind === "parameter" && found.length === item.size, `${item.label}: its numbers`);
      found.forEach((x, k) => {
        const node = this.graph.input(this.places.get(item.label), k), fixed = this.known.get(node);
        need(x.length === 2 && !less(x[1], x[0]) && (!fixed || String(fixed) === String(x)), `${item.label}: its numbers`);
        this.known.set(node, x);
      });
    }
    readProgram(given) {
      const g = this.graph, numbers = list(given.constants, "constants").map(rational), nodes = [];
      const exact = list(given.operations, "operations");
      need([given.a, given.b].every((x) => list(x, "program").length === given.code.length), "program: columns of one length");
      const constants = list(given.code, "code").map((code, k) => {
        const name = exact[whole(code, 0, exact.length, "an operation")], a = given.a[k], b = given.b[k];
        if (name === "const") {
          const q = numbers[whole(a, 0, numbers.length, "a constant")];
          nodes.push(g.number(q));
          return q;
        }
        if (name === "input") {
          const symbol = whole(a, 0, this.symbols.length, "an input");
          nodes.push(g.input(symbol, whole(b, 0, this.symbols[symbol].size, "an input")));
          return null;
        }
        const [x, y] = [a, b].map((x) => nodes[whole(x, 0, k, "an operand")]);
        nodes.push(this.operation(name, x, y, g.op[y] === NUMBER ? g.numbers[g.a[y]] : null));
        return null;
      });
      return constants.length ? nodes : [];
    }
    operation(name, x, y, exponent) {
      const g = this.graph;
      if (["add", "sub", "mul", "div", "inv", "neg"].includes(name)) return g[name](x, y);
      if (name === "sq") return g.mul(x, x);
      if (name === "twice") return g.add(x, x);
      if (name.endsWith("pow") && exponent && exponent[1] === 1n && exponent[0] ** 2n < 10000n) return g.power(x, Number(exponent[0]));
      need(CALLS.includes(name), `unknown operation ${name}`);
      return g.call(name, x, y);
    }
    readRates(given) {
      return new Map(Object.entries(given).map(([label, k]) => {
        const item = this.symbol(label), kinds = this.samples ? ["state"] : ["state", "trajectory"];
        need(kinds.includes(item.kind) && this.vector(k).length === item.size, `the rate of ${label}`);
        return [this.places.get(label), this.vector(k)];
      }));
    }
    readTerm(item) {
      keys(item, "a term", "name level role rule parts", "assumed phi");
      need(ROLES[item.role].includes(item.rule), `${item.name}: unknown rule`);
      keys(item.parts, item.name, PARTS[item.rule]);
      need(item.level === "" || this.symbol(item.level).kind === "weight", `${item.name}: its level`);
      need(item.rule !== "monotone" || ["tanh", "atan"].includes(item.phi), `${item.name}: unknown function`);
      const parts = Object.fromEntries(Object.entries(item.parts).map(([name, k]) => [name, this.vector(k)]));
      return { ...item, ...parts, level: item.level, weightOf: item.level ? this.inputs(item.level)[0] : ONE };
    }
    symbol(label) { return this.symbols[this.places.get(label) ?? fail(`unknown symbol ${label}`)]; }
    inputs(label) { return Array.from({ length: this.symbol(label).size }, (_, k) => this.graph.input(this.places.get(label), k)); }
    vector(k) { return this.vectors[whole(k, 0, this.vectors.length, "a vector")]; }
    term(k) { return this.terms[whole(k, 0, this.terms.length, "a term")]; }
    next(label) { return this.moves.get(this.places.get(label)) ?? fail(`${label}: no rate or next value`); }
    // These depend on constants alone; or, if `moving`, also on what has a rate.
    constant(nodes, text, moving) {
      for (const k of this.graph.reads(nodes)) {
        const { kind, label } = this.symbols[k], moves = this.moves.has(k) || (kind === "time" && !this.samples);
        need(CONSTANT.includes(kind) || (moving && moves), `${text} depends on ${label}`);
      }
    }
    // Derivatives; NONE where there is none, or of a symbol without a rate.
    rates(nodes, moves = this.moves, found = this.derivatives) {
      const g = this.graph;
      return g.rates(nodes, (k) => {
        const { kind } = this.symbols[g.a[k]], rate = moves.get(g.a[k]);
        return rate ? rate[g.b[k]] : kind === "time" ? ONE : CONSTANT.includes(kind) ? ZERO : NONE;
      }, found);
    }
    exactRates(nodes, moves) {
      const found = moves ? this.rates(nodes, moves, new Map()) : this.rates(nodes);
      need(!found.includes(NONE), "a derivative that does not exist, or of a function without a rule");
      return found;
    }
  }

  // ---- Terms and the identity

  function weighted(g, weight, vector) {
    const n = vector.length;
    if (weight.length !== n * n || n === 1) return spread(weight, n).map((w, k) => g.mul(w, vector[k]));
    return matrix(weight, n).map((row) => g.dot(row, vector));
  }

  function termValue(of, term) {
    const g = of.graph, a = term.vector, w = term.weight;
    if (term.rule === "square") return g.dot(a, weighted(g, w, a));
    if (term.rule === "gathered") { // c |a|^2_G
      need(w.length === 1 && term.memory.length === a.length ** 2, "an information matrix");
      return g.mul(w[0], g.dot(a, matrix(term.memory, a.length).map((row) => g.dot(row, a))));
    }
    if (term.rule === "monotone") { // sum w (a - b) (phi(a / v) - phi(b / v))
      const n = term.first.length, v = spread(term.scale, n), steps = g.minus(term.first, term.second);
      const phi = [term.first, term.second].map((x) => x.map((x, k) => g.call(term.phi, g.div(x, v[k]))));
      return g.dot(spread(w, n), steps.map((x, k) => g.mul(x, g.sub(phi[0][k], phi[1][k]))));
    }
    need(term.rule === "potential", "unknown rule"); // sum 2 w v^2 (sqrt(1 + (a / v)^2) - 1)
    return g.total(a.map((x, k) => {
      const v = spread(term.width, a.length)[k], factor = g.mul(spread(w, a.length)[k], g.mul(v, v));
      return g.mul(g.add(factor, factor), g.sub(root(g, x, v), ONE));
    }));
  }
  const root = (g, x, v) => g.call("sqrt", g.add(ONE, g.power(g.div(x, v), 2)));

  // d/dt of c (log det A - log det B + tr(A^-1 B) - n) is c (tr(A^-1 A') - tr(A^-1 A' A^-1 B)).
  function divergenceRate(of, term) {
    const g = of.graph, n = Math.sqrt(term.matrix.length), [A, B, dA] = [term.matrix, term.true, of.exactRates(term.matrix)].map((x) => matrix(x, n));
    need(term.true.length === n * n && term.weight.length === 1, "a divergence");
    of.constant([...term.true, ...term.weight], "a divergence");
    const steps = g.solve(A, dA), ratio = g.solve(A, B), trace = (X) => g.total(X.map((row, i) => row[i]));
    return g.mul(term.weight[0], g.sub(trace(steps), trace(g.matmul(steps, ratio))));
  }

  // Names and nodes that must vanish; the first one is V, which must not.
  function inFlow(of) {
    const g = of.graph, half = g.number([1n, 2n]), found = [];
    let V = ZERO, total = ZERO;
    for (const term of of.terms) {
      const divergence = term.rule === "log_det", value = divergence ? ONE : termValue(of, term);
      if (term.role === "stored") {
        const rate = divergence ? divergenceRate(of, term) : of.exactRates([value])[0];
        V = g.add(V, g.mul(term.weightOf, value));
        total = g.add(total, g.mul(term.weightOf, g.mul(half, rate)));
      } else total = g[term.role === "dissipated" ? "add" : "sub"](total, g.mul(term.weightOf, value));
    }
    for (const item of of.projections) { // (estimate - true value)' W correction
      const term = of.term(item.term), name = item.state, estimate = of.inputs(name), correction = of.inputs(item.correction);
      need(item.correction === `${name}, correction` && of.symbol(name).kind === "state" && term.rule === "square" &&
        of.symbol(item.correction).kind === "projection", `${name}: its projection`);
      total = g.sub(total, g.mul(term.weightOf, g.dot(weighted(g, term.weight, term.vector), correction)));
      const true_ = of.vector(item.true), without = g.replaced(of.next(name), (k) => (correction.includes(k) ? ZERO : k));
      found.push([`the error of ${name}`, g.minus(term.vector, g.minus(estimate, spread(true_, estimate.length)))]);
      found.push([`the rate of the true value of ${name}`, of.exactRates(true_)]);
      found.push([`the rate of ${name}`, g.minus(g.minus(of.next(name), without), correction)]);
    }
    for (const { term, by } of of.cross) { // a = sum_j share_j v_j
      let left = of.term(term).vector;
      for (const [share, k] of by) {
        const v = of.term(k).vector, factor = spread(of.vector(share), v.length);
        left = g.minus(left, v.map((x, i) => g.mul(x, factor[i])));
      }
      found.push(["the vector of a cross term", left]);
    }
    for (const term of of.terms) {
      if (term.rule === "gathered") { // dG/dt = W' diag(r) W - forgetting G
        const n = term.vector.length, W = matrix(term.regressor, term.regressor.length / n), by = spread(term.by, W.length);
        need(term.forgetting.length === 1, "a forgetting factor");
        const gained = g.matmul(transposed(W), W.map((row, i) => row.map((x) => g.mul(by[i], x)))).flat();
        const decay = term.memory.map((x) => g.mul(term.forgetting[0], x));
        found.push(["dG/dt", g.minus(of.exactRates(term.memory), g.minus(transposed(matrix(gained, n)).flat(), decay))]);
      }
      for (const flat of term.rule === "log_det" ? [term.matrix, term.true] : []) {
        const rows = matrix(flat, Math.sqrt(flat.length));
        found.push([`symmetry of ${term.name}`, g.minus(rows.flat(), transposed(rows).flat())]);
      }
    }
    for (const item of of.masses) found.push(...robot(of, item));
    return [["V", [V]], ["dV/dt", [total]], ...found];
  }

  // A chain of rigid bodies in homogeneous coordinates: T_i places link i in the world, and its pseudo-inertia S_i is the
  // integral of r r' dm over the points r = (x, y, z, 1) of the link. By d'Alembert's principle, the force of joint j is
  // sum_i tr(dT_i/dq_j S_i (d2T_i/dt2 - gravity)'), and the mass matrix has the elements sum_i tr(dT_i/dq_j S_i dT_i/dq_k').
  function robot(of, item) {
    const g = of.graph, motion = item.motion && keys(item.motion, "a motion", "velocity acceleration gravity torque");
    const [q, moves, inertia, weight] = ["position", "translations", "inertia", "weight"].map((name) => of.vector(item[name])), n = q.length;
    const rotors = item.rotors === null ? Array(n).fill(ZERO) : spread(of.vector(item.rotors), n);
    const [dq, ddq, gravity, torque] = motion ? ["velocity", "acceleration", "gravity", "torque"].map((name) => of.vector(motion[name])) : [];
    need(item.joints.length === n && moves.length >= 3 * n && inertia.length === 10 * n, "a chain: sizes of its parts");
    const scaled = (X, factor) => X.map((row) => row.map((x) => g.mul(x, factor)));
    const plus = (X, Y) => X.map((row, i) => row.map((x, j) => g.add(x, Y[i][j])));
    const nothing = Array(3).fill(Array(4).fill(ZERO)), sums = Array(n).fill(ZERO), M = sums.map(() => [...sums]);
    let T = matrix([ONE, ZERO, ZERO, ZERO, ONE, ZERO, ZERO, ZERO, ONE, ZERO, ZERO, ZERO], 3), V = nothing, U = [];
    let C = gravity ? matrix([...Array(9).fill(ZERO), ...gravity.map((x) => g.neg(x))], 3) : nothing;
    for (let i = 0; i < n; i++) {
      const { A, K } = joint(g, item.joints[i], q[i], moves.slice(3 * i, 3 * i + 3));
      U = [...U.map((X) => g.matmul(X, A)), g.matmul(g.matmul(T, A), K)];
      if (motion) {
        const moved = g.matmul(V, A), own = scaled(U[i], dq[i]), inner = g.matmul(scaled(plus(plus(moved, moved), own), dq[i]), K);
        C = plus(plus(g.matmul(C, A), inner), scaled(U[i], ddq[i]));
        V = plus(moved, own);
      }
      T = g.matmul(T, A);
      const S = pseudo(g, inertia.slice(10 * i, 10 * i + 10)), flat = U.map((X) => X.flat());
      U.forEach((X, j) => {
        const momentum = g.matmul(X, S).flat();
        flat.forEach((other, k) => { M[j][k] = g.add(M[j][k], g.dot(momentum, other)); });
        if (motion) sums[j] = g.add(sums[j], g.dot(momentum, C.flat()));
      });
    }
    for (let i = 0; i < n; i++) M[i][i] = g.add(M[i][i], rotors[i]);
    const found = [["the mass matrix", g.minus(weight, M.flat())]];
    if (motion) {
      found.push(["the robot's equation of motion", g.minus(sums.map((x, i) => g.add(x, g.mul(rotors[i], ddq[i]))), torque)]);
      found.push(["the robot's velocity", g.minus(of.exactRates(q), dq)], ["the robot's acceleration", g.minus(of.exactRates(dq), ddq)]);
    }
    return found;
  }

  // The transform A of a joint, with dA/dq = A K.
  function joint(g, item, q, origin) {
    keys(item, "a joint", "kind axis rotation");
    const axis = item.axis.map(rational), R = transposed(matrix(item.rotation.map(rational), 3));
    const one = (rows) => rows.every((x, i) => rows.every((y, j) => String(x.reduce((s, a, k) => sum(s, product(a, y[k])), zeroQ)) === (i === j ? "1,1" : "0,1")));
    const minor = (i, j) => sum(product(R[0][i], R[1][j]), product(minusOne, product(R[0][j], R[1][i])));
    need(axis.length === 3 && R.flat().length === 9 && one([axis]) && one(R) && [0, 1, 2].every((k) => String(R[2][k]) === String(minor((k + 1) % 3, (k + 2) % 3))), "a joint: expected a unit axis and a rotation");
    const [x, y, z] = axis.map((x) => g.number(x)), a = [x, y, z], turns = item.kind === "revolute";
    need(turns || item.kind === "prismatic", "a joint: expected revolute or prismatic");
    const K = turns ? [[ZERO, g.neg(z), y, ZERO], [z, ZERO, g.neg(x), ZERO], [g.neg(y), x, ZERO, ZERO]] : a.map((e) => [ZERO, ZERO, ZERO, e]);
    let turned = R.map((row) => row.map((x) => g.number(x)));
    if (turns) {
      const c = g.call("cos", q), s = g.call("sin", q);
      turned = g.matmul(turned, a.map((e, i) => a.map((f, j) =>
        g.add(g.add(i === j ? c : ZERO, g.mul(s, K[i][j])), g.mul(g.sub(ONE, c), g.mul(e, f))))));
    } else origin = origin.map((e, i) => g.add(e, g.mul(q, g.dot(turned[i], a))));
    return { A: [...turned.map((row, i) => [...row, origin[i]]), [ZERO, ZERO, ZERO, ONE]], K: [...K, Array(4).fill(ZERO)] };
  }
  function pseudo(g, [m, hx, hy, hz, xx, xy, yy, xz, yz, zz]) {
    const half = g.mul(g.number([1n, 2n]), g.total([xx, yy, zz])), [a, b, c] = [xy, xz, yz].map((x) => g.neg(x));
    return [[g.sub(half, xx), a, b, hx], [a, g.sub(half, yy), c, hy], [b, c, g.sub(half, zz), hz], [hx, hy, hz, m]];
  }

  // ---- Samples

  function overSamples(of) {
    const g = of.graph, half = g.number([1n, 2n]), found = [];
    let V = ZERO, total = ZERO;
    for (const term of of.terms) {
      need(term.rule === "square" && !term.level && term.role !== "cross", "over samples: expected squares");
      let value = termValue(of, term);
      if (term.role === "stored") {
        const [later] = g.replaced([value], (k) => of.moves.get(g.a[k])?.[g.b[k]] ?? k);
        V = g.add(V, value);
        value = g.mul(half, g.sub(later, value));
      }
      total = g[term.role === "residual" ? "sub" : "add"](total, value);
    }
    for (const steps of of.steps) found.push(...stepsOf(of, steps));
    for (const line of of.lines) {
      found.push([line.state, g.minus(of.vector(line.before), of.inputs(line.state))]);
      found.push([`the next value of ${line.state}`, g.minus(of.next(line.state), shifted(of, line))]);
    }
    for (const { momentum, rest } of of.plant) { // d/dt momentum + rest = 0
      const change = of.exactRates(of.vector(momentum), of.between);
      found.push(["a plant identity", g.minus(change, of.vector(rest).map((x) => g.neg(x)))]);
    }
    for (const k of of.solved) found.push(["an equation that an output solves", of.vector(k)]);
    return [["V", [of.steps.length ? ONE : V]], ["V(next) - V", [total]], ...found];
  }

  // Steps of an estimate: for each output and each of its rows (h, y) in turn, with e = y - h'theta:
  // normalised     theta <- theta + D h e / n, n = floor + h' D h, D the gain
  // least_squares  theta <- theta + P h e / n, P = (G + 1/D)^-1, n = floor + h' P h, then G <- G + h h' / floor
  // A box moves theta towards the true value inside it; a factor of G in [0, 1] forgets.
  function stepsOf(of, steps) {
    const g = of.graph, name = steps.estimate, squares = steps.rule === "least_squares", part = {};
    for (const [key, k] of Object.entries(steps.parts)) part[key] = of.vector(k);
    const sizes = list(steps.sizes, name).map((n) => whole(n, 1, LARGEST, "a size"));
    need(squares || steps.rule === "normalised", `unknown rule ${steps.rule} of steps`);
    need(part.floor.length === 1, "a floor");
    for (const key of ["true", "gain", "floor", "retention", "lower", "upper"]) of.constant(part[key] ?? [], `${name}: ${key}`);
    const pieces = (column, lengths) => {
      let end = 0;
      const found = lengths.map((n) => column.slice(end, (end += n)));
      need(end === column.length, "the steps of an estimate: sizes of its parts");
      return found;
    };
    const theta = pieces(part.theta, sizes), gain = pieces(part.gain, sizes), moved = [], kept = [];
    const [lower, upper] = steps.box ? [pieces(part.lower, sizes), pieces(part.upper, sizes)] : [];
    const rows = Array.from({ length: whole(steps.rows, 1, LARGEST, "rows") }, (_, k) => [pieces(part[`h${k}`], sizes), part[`y${k}`]]);
    const triangles = squares ? pieces(part.gathered, sizes.map((n) => (n * (n + 1)) / 2)) : [];
    sizes.forEach((n, j) => {
      let now = theta[j], G = squares ? symmetric(n, triangles[j]) : null;
      const metric = gain[j].map((x) => g.inv(x)), [floor] = part.floor;
      for (const [row, y] of rows) {
        const h = row[j];
        let direction = h.map((x, i) => g.mul(x, gain[j][i]));
        if (squares) {
          direction = g.solve(raised(g, G, metric), h.map((x) => [x])).flat();
          G = G.map((line, i) => line.map((x, k) => g.add(x, g.mul(h[i], g.div(h[k], floor)))));
        }
        const step = g.div(g.sub(y[j], g.dot(h, now)), g.add(floor, g.dot(h, direction)));
        now = now.map((x, i) => g.add(x, g.mul(direction[i], step)));
        if (steps.box) [now, G] = intoBox(g, now, G, metric, lower[j], upper[j]);
      }
      moved.push(...now);
      if (squares) G.forEach((_, k) => { for (let i = k; i < n; i++) kept.push(g.mul(part.retention[0], G[i][k])); });
    });
    const found = [[name, g.minus(part.theta, of.inputs(name))], [`the next value of ${name}`, g.minus(of.next(name), moved)]];
    if (squares) {
      found.push([steps.memory, g.minus(part.gathered, of.inputs(steps.memory))]);
      found.push([`the next value of ${steps.memory}`, g.minus(of.next(steps.memory), kept)]);
    }
    return found;
  }
  // A symmetric matrix from its lower triangle, column by column.
  function symmetric(n, triangle) {
    const G = Array.from({ length: n }, () => []);
    let at = 0;
    for (let k = 0; k < n; k++) for (let i = k; i < n; i++) G[i][k] = G[k][i] = triangle[at++];
    return G;
  }
  const raised = (g, G, metric) => G.map((row, i) => row.map((x, k) => (i === k ? g.add(x, metric[i]) : x)));
  const clip = (g, x, low, high) => g.call("fmin", g.call("fmax", x, low), high);

  // Onto a box; least squares: onto one face after the other in the norm of G + 1/D, then by clipping, which sets G to
  // zero where it changes an element.
  function intoBox(g, theta, G, metric, lower, upper) {
    const clipped = (x) => x.map((x, i) => clip(g, x, lower[i], upper[i]));
    if (!G) return [clipped(theta), null];
    const P = g.solve(raised(g, G, metric), G.map((_, i) => G.map((_, k) => (i === k ? ONE : ZERO))));
    theta.forEach((_, i) => {
      const face = clip(g, theta[i], lower[i], upper[i]), factor = g.div(g.sub(theta[i], face), P[i][i]);
      theta = theta.map((x, k) => (k === i ? face : g.sub(x, g.mul(P[k][i], factor))));
    });
    const cut = clipped(theta);
    const kept = cut.slice(0, -1).reduce((all, x, i) => g.mul(all, g.call("eq", theta[i], x)), ONE);
    return [cut, G.map((row) => row.map((x) => g.mul(x, kept)))];
  }

  // A delay line at the next sample: the newest entry comes first, the oldest is dropped.
  function shifted(of, line) {
    const g = of.graph, newest = of.vector(line.newest), before = of.vector(line.before);
    const rows = of.rows[line.newest], height = of.rows[line.before], width = before.length / height;
    let after = [...newest, ...before].slice(0, before.length);
    if (newest.length / rows === width) {
      after = before.map((_, k) => (k % height < rows ? newest[(k % height) + Math.floor(k / height) * rows] : before[k - rows]));
    }
    if (line.when === null) return after;
    const [when] = of.vector(line.when), kept = g.call("not", when);
    return after.map((x, k) => g.add(g.call("if_else_zero", when, x), g.call("if_else_zero", kept, before[k])));
  }

  // ---- Degrees: a node is N / (product of divisors d^e), a sum takes the largest exponent of each divisor

  // log2 of the sum of absolute coefficients is the height. Bound D + H on degree and height of the numerators that must
  // vanish, with those of all divisors, and of the differences of all arguments of one function.
  function degrees(g, nodes) {
    const found = new Map(), divisors = new Map(), callers = new Map(), none = new Map();
    const size = (n) => n.toString(2).length;
    const over = (powers) => [...powers].reduce((total, [key, e]) => [0, 1].map((i) => total[i] + e * divisors.get(key)[i]), [0, 0]);
    const named = (key, bound) => { divisors.set(key, bound); return new Map([[key, 1]]); };
    const add = (x, y) => {
      let powers = x.powers, missing = [[0, 0], [0, 0]];
      if (x.powers !== y.powers) {
        powers = new Map(x.powers);
        for (const [key, e] of y.powers) powers.set(key, Math.max(e, powers.get(key) ?? 0));
        const all = over(powers);
        missing = [x, y].map((z) => (z.size ??= over(z.powers)).map((part, i) => all[i] - part));
        if (powers.size === x.powers.size && missing[0][0] + missing[0][1] === 0) powers = x.powers;
      }
      const heights = [x.height + missing[0][1], y.height + missing[1][1]], high = Math.max(...heights);
      const height = high + Math.log2(1 + 2 ** (Math.min(...heights) - high)) + 1e-6;
      return { degree: Math.max(x.degree + missing[0][0], y.degree + missing[1][0]), height, powers };
    };
    const mul = (x, y) => {
      let powers = x.powers.size ? x.powers : y.powers;
      if (x.powers.size && y.powers.size) {
        powers = new Map(x.powers);
        for (const [key, e] of y.powers) powers.set(key, e + (powers.get(key) ?? 0));
      }
      return { degree: x.degree + y.degree, height: x.height + y.height, powers };
    };
    for (const k of g.slice(nodes)) {
      const op = g.op[k], [x, y] = g.operands(k).map((x) => found.get(x)), name = g.name(k);
      let own = { degree: 1, height: 0, powers: none };
      if (op === NUMBER) {
        const [n, d] = g.numbers[g.a[k]];
        own = { degree: 0, height: size(n < 0n ? -n : n), powers: d === 1n ? none : named(`1/${d}`, [0, size(d)]) };
      } else if (op === ADD || op === SUB) own = add(x, y);
      else if (op === MUL) own = mul(x, y);
      else if (op === INV) {
        const [degree, height] = over(x.powers);
        own = { degree, height, powers: named(k, [x.degree, x.height]) };
      } else if (op >= CALL) {
        const key = name === "cos" ? "sin" : name;
        callers.set(key, (callers.get(key) ?? new Set()));
        for (const x of g.operands(k)) callers.get(key).add(x);
        if (key === "sin") own = { degree: 2, height: 1, powers: named(`circle ${g.a[k]}`, [2, 1]) }; // of 1 + t^2
      }
      found.set(k, own);
    }
    const all = nodes.map((k) => found.get(k));
    let total = Math.max(...all.map((x) => x.degree)) + Math.max(...all.map((x) => x.height));
    for (const [degree, height] of divisors.values()) total += degree + height;
    for (const nodes of callers.values()) { // x = y or x = -y of two arguments, and x = 0
      const each = [...nodes].map((k) => found.get(k)).map((x) => x.degree + x.height + over(x.powers)[0] + over(x.powers)[1] + 1);
      total += 2 * (nodes.size + 1) * each.reduce((a, b) => a + b, 0);
    }
    return total;
  }

  // ---- Prime fields

  const words = new Uint32Array(4096);
  let used = words.length;
  function bits(count) {
    let value = 0n;
    for (let k = 0; k < count; k += 32) {
      if (used === words.length) {
        (globalThis.crypto ?? require("crypto").webcrypto).getRandomValues(words);
        used = 0;
      }
      value = (value << 32n) | BigInt(words[used++]);
    }
    return value & ((1n << BigInt(count)) - 1n);
  }
  const below = (p, size) => bits(size + 96) % p;
  function powered(x, n, p) {
    let value = 1n;
    for (; n; n >>= 1n, x = (x * x) % p) if (n & 1n) value = (value * x) % p;
    return value;
  }
  // By the test of Miller and Rabin with 64 random bases.
  function randomPrime(size) {
    for (;;) {
      const n = bits(size) | (1n << BigInt(size - 1)) | 1n;
      if ([3n, 5n, 7n, 11n, 13n, 17n, 19n, 23n, 29n, 31n].some((x) => n % x === 0n)) continue;
      let odd = n - 1n, twos = 0, k = 0;
      for (; !(odd & 1n); odd >>= 1n) twos++;
      const passes = () => {
        let x = powered(below(n - 3n, size) + 2n, odd, n);
        if (x === 1n) return true;
        for (let i = 0; i < twos; i++, x = (x * x) % n) if (x === n - 1n) return true;
        return false;
      };
      while (k < 64 && passes()) k++;
      if (k === 64) return n;
    }
  }

  class Vanishes extends Error {}

  // A point of a prime field: symbols are random, except those given. A function has a random value for each argument;
  // sin and cos of one are a random point of the unit circle. If `frozen`, a bounded function keeps its value whatever
  // its argument is: its nodes are symbols of their own.
  class Point {
    constructor(of, p, size, given, frozen) { Object.assign(this, { of, g: of.graph, p, size, given, frozen, values: [], memory: new Map() }); }
    random() { return below(this.p, this.size); }
    memo(key) {
      if (!this.memory.has(key)) this.memory.set(key, this.random());
      return this.memory.get(key);
    }
    inverse(x) {
      let [a, b, s, t] = [x, this.p, 1n, 0n];
      while (b) { const q = a / b; [a, b, s, t] = [b, a - q * b, t, s - q * t]; }
      if (a !== 1n) throw new Vanishes("a divisor vanishes");
      return s < 0n ? s + this.p : s;
    }
    residue([n, d]) { const x = n % this.p; return ((x < 0n ? x + this.p : x) * (d === 1n ? 1n : this.inverse(d % this.p))) % this.p; }
    at(nodes) {
      const v = this.values;
      if (nodes.some((k) => v[k] === undefined)) for (const k of this.g.slice(nodes)) v[k] ??= this.value(k);
      return nodes.map((k) => v[k]);
    }
    value(k) {
      const { g, p, values } = this, op = g.op[k], x = values[g.a[k]], y = values[g.b[k]];
      switch (op) {
        case MUL: return (x * y) % p;
        case ADD: { const s = x + y; return s < p ? s : s - p; }
        case SUB: { const s = x - y; return s < 0n ? s + p : s; }
        case INV: return this.inverse(x);
        case NUMBER:
          if (!this.given.has(k)) this.given.set(k, this.residue(g.numbers[g.a[k]]));
          return this.given.get(k);
        case INPUT: return this.given.get(k) ?? this.random();
      }
      const name = g.name(k), mirrored = x && p - x, even = x < mirrored ? x : mirrored;
      if (this.frozen && BOUNDED.includes(name)) return /^(sin|cos)$/.test(name) ? this.turned(`circle of ${g.a[k]}`, name, 1n) : this.random();
      if (name === "sin" || name === "cos") return x ? this.turned(`circle at ${even}`, name, x) : BigInt(name === "cos");
      if (name === "fabs") return this.memo(`fabs ${even}`);
      return this.memo(`${name} ${x} ${UNARY.includes(name) ? "" : y}`);
    }
    turned(circle, name, angle) {
      const { p, memory } = this;
      if (!memory.has(circle)) {
        const t = this.random(), scale = this.inverse((1n + t * t) % p);
        memory.set(circle, { cos: ((1n + (p - t) * t) * scale) % p, sin: (2n * t * scale) % p });
      }
      const value = memory.get(circle)[name];
      return name === "cos" || 2n * angle < p ? value : (p - value) % p;
    }
    // Rates of change of nodes along a direction (of input nodes).
    along(nodes, direction) {
      this.at(nodes);
      const { g, p, values: v } = this, t = new Map();
      for (const k of g.slice(nodes)) {
        const op = g.op[k], a = g.a[k], b = g.b[k];
        let rate = 0n;
        if (op === INPUT) rate = direction.get(k) ?? 0n;
        else if (op === ADD) rate = (t.get(a) + t.get(b)) % p;
        else if (op === SUB) rate = (t.get(a) - t.get(b) + p) % p;
        else if (op === MUL) rate = (v[a] * t.get(b) + v[b] * t.get(a)) % p;
        else if (op === INV) rate = (((p - t.get(a)) * v[k]) % p * v[k]) % p;
        else if (op >= CALL && !BOUNDED.includes(g.name(k)) && g.operands(k).some((x) => t.get(x))) rate = this.random();
        t.set(k, rate);
      }
      return nodes.map((k) => t.get(k));
    }
    // The gradient of a node that does not depend on open directions by functions.
    gradient(node) {
      const { g, p, values: v } = this, found = new Map([[node, 1n]]), inputs = new Map();
      const give = (k, x) => found.set(k, ((found.get(k) ?? 0n) + x) % p);
      for (const k of g.slice([node]).reverse()) {
        const op = g.op[k], a = g.a[k], b = g.b[k], x = found.get(k);
        if (!x) continue;
        if (op === INPUT) inputs.set(k, x);
        else if (op === ADD) { give(a, x); give(b, x); }
        else if (op === SUB) { give(a, x); give(b, p - x); }
        else if (op === MUL) { give(a, x * v[b]); give(b, x * v[a]); }
        else if (op === INV) give(a, (p - x) * ((v[k] * v[k]) % p));
      }
      return inputs;
    }
  }

  // log2 of the error bound and the number of points; refutes at a point where an equality does not hold.
  function identity(of) {
    const equalities = (of.samples ? overSamples : inFlow)(of), all = equalities.flatMap(([, nodes]) => nodes);
    const total = Math.log2(degrees(of.graph, all)), size = SIZES.find((size) => total + 3 - size < -64);
    need(size, `the degree of the identity is too high: D + H is 2^${total}`);
    const error = 3 + total - size;
    let points = 0;
    for (let tried = 0; points * error > WANTED; tried++) {
      need(tried < 40, "a divisor vanishes at every point");
      const point = new Point(of, randomPrime(size), size, new Map());
      try {
        for (const label of of.fixed) for (const k of of.inputs(label)) point.given.set(k, point.residue(of.known.get(k)[0]));
        point.at(all);
        for (const [name, nodes] of equalities) if (point.at(nodes).some((x) => x) === (name !== "V")) refute(`${name} does not hold`);
        points++;
      } catch (fault) {
        if (!(fault instanceof Vanishes)) throw fault;
      }
    }
    return [points * error, points];
  }

  // ---- Signs, conditions and small gain

  class Signs {
    constructor(of) { Object.assign(this, { of, boxes: new Map(), believed: [] }); }
    // Intervals of nodes; null if they depend on more than parameters (and boxes), or on a function.
    bounds(nodes, boxes = new Map()) {
      try {
        return this.intervals(nodes, boxes);
      } catch (fault) {
        if (fault instanceof TooLong) return null;
        throw fault;
      }
    }
    intervals(nodes, boxes) {
      const g = this.of.graph, found = new Map();
      for (const k of g.slice(nodes)) {
        const op = g.op[k], [a, b] = g.operands(k), [x, y] = [a, b].map((x) => found.get(x)), name = g.name(k);
        let own = null;
        if (op === NUMBER) own = [g.numbers[g.a[k]], g.numbers[g.a[k]]];
        else if (op === INPUT) own = this.of.known.get(k) ?? boxes.get(k);
        else if (op === ADD) own = plusI(x, y);
        else if (op === SUB) own = minusI(x, y);
        else if (op === MUL) own = timesI(x, y, a === b);
        else if (op === INV) own = inverseI(x);
        else if (name === "fmin") own = [least([x[0], y[0]]), least([x[1], y[1]])];
        else if (name === "fmax") own = [most([x[0], y[0]]), most([x[1], y[1]])];
        else if (name === "fabs") own = [most([zeroQ, x[0], product(minusOne, x[1])]), most([x[1], product(minusOne, x[0])])];
        if (!own) return null;
        found.set(k, own);
      }
      return nodes.map((k) => found.get(k));
    }
    // 1 if all elements, or a matrix, are positive, 0 if none is negative, -1 otherwise or if not decided.
    sign(nodes, size = 0) {
      const values = this.bounds(nodes);
      if (!values) return -1;
      if (size > 1 && values.length === size * size) {
        const rows = matrix(values, size);
        return String(rows) === String(transposed(rows)) && definite(rows) ? 1 : -1;
      }
      return Math.min(1, ...values.map((x) => (positive(x[0]) ? 1 : x[0][0] === 0n ? 0 : -1)));
    }
    inside(name, lower, true_, upper) {
      const estimate = this.of.inputs(name), [low, high] = [lower, upper].map((k) => this.bounds(spread(this.of.vector(k), estimate.length)));
      if (!low || !high) refute(`${name}: its box is not made of parameters`);
      if (low.some((x, k) => less(high[k][0], x[1]))) refute(`${name}: its box is empty`);
      const value = this.bounds(spread(this.of.vector(true_), estimate.length));
      if (!value) this.believed.push(`${name}: its true value is inside the box`);
      estimate.forEach((node, k) => {
        if (value && (less(value[k][0], low[k][1]) || less(high[k][0], value[k][1]))) refute(`${name}: its true value is not inside the box`);
        this.boxes.set(node, [low[k][0], high[k][1]]);
      });
    }
    weight(term) {
      const { rule, name, weight: W } = term, n = term.vector?.length ?? 0, sign = this.sign(W, rule === "square" ? n : 0);
      if (rule === "square" && term.role !== "cross" && !this.bounds(W)) {
        for (const item of this.of.masses) if (W.length === n * n && String(this.of.vector(item.weight)) === String(W)) return this.mass(item);
        if (term.assumed) {
          this.believed.push(`${name}: its weight is positive: ${term.assumed}`);
          return 1;
        }
      }
      if (rule === "monotone" || rule === "potential") return this.sign(term.scale ?? term.width) === 1 ? sign : -1;
      if (rule === "gathered") {
        this.believed.push(`${name}: its information matrix starts at zero`);
        return Math.min(0, sign, this.sign(term.by), this.sign(term.forgetting));
      }
      if (rule === "log_det") {
        this.believed.push(`${name}: it starts positive definite`);
        return Math.min(sign, this.sign(term.true, Math.sqrt(term.true.length)));
      }
      return sign;
    }
    // A mass matrix is positive definite if each link's pseudo-inertia is, and no rotor's inertia is negative.
    mass(item) {
      const { of } = this, inertia = of.vector(item.inertia);
      if (item.rotors !== null && this.sign(of.vector(item.rotors)) < 0) return -1;
      if (!this.bounds(inertia)) this.believed.push("the load of the mass matrix is a rigid body");
      else for (let k = 0; k < inertia.length; k += 10) if (this.sign(pseudo(of.graph, inertia.slice(k, k + 10)).flat(), 4) < 1) return -1;
      return 1;
    }
    // Checks all signs; returns the terms with a positive weight.
    check() {
      const { of } = this, strict = new Set();
      for (const term of of.terms.filter((item) => item.role !== "residual")) {
        const sign = this.weight(term);
        if (sign < (term.role === "stored" && term.rule !== "gathered" ? 1 : 0)) refute(`${term.name}: the sign of its weight is wrong, or not shown`);
        if (sign === 1) strict.add(term);
      }
      for (const item of of.projections) {
        const term = of.term(item.term), name = item.state;
        this.believed.push(`${name}: it starts inside its ${item.set}, and the law that runs is this projection`);
        if (item.set === "box") {
          need([1, term.vector.length].includes(term.weight.length) && strict.has(term), `${name}: expected a box with a diagonal metric`);
          this.inside(name, item.lower, item.true, item.upper);
        } else this.believed.push(`${name}: its ${item.set} is bounded, contains the true value, and suits the metric`);
      }
      for (const { parts, box, estimate, rule } of of.steps) {
        if (this.sign(of.vector(parts.gain)) !== 1 || this.sign(of.vector(parts.floor)) !== 1) refute(`${estimate}: gain and floor of its steps are not shown to be positive`);
        if (box) this.inside(estimate, parts.lower, parts.true, parts.upper);
        const kept = rule === "least_squares" && this.bounds(of.vector(parts.retention));
        if (kept === null || (kept && (less(kept[0][0], zeroQ) || less([1n, 1n], kept[0][1])))) refute(`${estimate}: its factor of forgetting is not shown to be in [0, 1]`);
      }
      for (const item of of.conditions) {
        if (item.margin === undefined || !this.bounds(of.vector(item.margin))) this.believed.push(`condition: ${item.name}`);
        else if (this.sign(of.vector(item.margin)) < (item.strict ? 1 : 0)) refute(`condition: ${item.name}`);
      }
      return strict;
    }
    // The least kappa with which the dissipation dominates the cross terms; null without any.
    // c |sum a_j v_j|^2 <= c max(sum_j a_j^2 / W_j) sum_j |v_j|^2_(W_j), by the inequality of Cauchy.
    kappa(strict) {
      const { of } = this, groups = [];
      for (const { term, by } of of.cross) {
        const c = of.term(term), used = new Set(by.map(([, k]) => of.term(k))), n = c.vector.length, level = by.length && of.term(by[0][1]).level;
        need(used.size === by.length && by.length && [...used].every((item) => item.level === level), "a cross term: expected squares of one level");
        need(!c.level && c.weight.length === 1 && c.role === "cross", "a cross term: expected one number as its weight");
        const ratios = by.map(([share, k]) => {
          const item = of.term(k), [a, W] = [of.vector(share), item.weight].map((x) => this.bounds(spread(x, n)));
          if (!strict.has(item) || item.role !== "dissipated" || item.rule !== "square" || !a || !W) refute("no square with a positive weight of parameters dominates a cross term");
          return a.map((x, i) => timesI(timesI(x, x, true), inverseI(W[i])));
        });
        const [weight] = this.bounds(c.weight) ?? refute("the weight of a cross term is not made of parameters");
        const largest = most(ratios.reduce((x, y) => x.map((a, i) => plusI(a, y[i]))).map((x) => timesI(weight, x)[1]));
        let group = groups.find((item) => [...used].some((x) => item.used.has(x)));
        if (!group) groups.push((group = { used, sum: zeroQ }));
        need(group.used.size === used.size && [...used].every((x) => group.used.has(x)), "cross terms share a part of their squares");
        group.sum = sum(group.sum, largest);
        if (!level && !less(group.sum, [1n, 1n])) refute("the dissipation does not dominate a cross term");
      }
      const declared = of.cross.map((item) => of.term(item.term));
      for (const term of of.terms) if (term.role === "cross" && !declared.includes(term)) refute(`${term.name}: nothing dominates its cross term`);
      if (!groups.length) return null;
      const [n, d] = most(groups.map((item) => item.sum));
      return d === 1n ? `${n}` : `${n}/${d}`;
    }
  }

  // ---- Conclusions in continuous time

  class Echelon { // rows in reduced echelon form modulo p
    constructor(p) { Object.assign(this, { p, rows: new Map() }); }
    reduced(row) {
      row = [...row];
      for (const [pivot, other] of this.rows) if (row[pivot]) this.subtract(row, other, row[pivot]);
      return row;
    }
    subtract(row, other, factor) {
      const { p } = this, minus = p - factor;
      other.forEach((x, k) => { if (x) row[k] = (row[k] + minus * x) % p; });
    }
    has(row) { return this.reduced(row).every((x) => !x); }
    add(given, inverse) {
      const row = this.reduced(given), pivot = row.findIndex((x) => x);
      if (pivot < 0) return false;
      const scale = inverse(row[pivot]), own = row.map((x) => x && (x * scale) % this.p);
      for (const other of this.rows.values()) if (other[pivot]) this.subtract(other, own, other[pivot]);
      this.rows.set(pivot, own);
      return true;
    }
    // A direction that all rows map to zero, with these numbers at the free columns.
    open(count, free) {
      const u = Array.from({ length: count }, (_, k) => (this.rows.has(k) ? 0n : free(k))), at = [...u.keys()].filter((k) => u[k]);
      for (const [pivot, row] of this.rows) u[pivot] = at.reduce((s, k) => (row[k] ? (s + (this.p - row[k]) * u[k]) % this.p : s), 0n);
      return u;
    }
  }

  // Bounded and vanishing signals, if V does not increase and trajectories, with their rates, are bounded. A direction of
  // the state space is open if no bounded signal determines it. With bounded functions frozen, a signal whose derivative
  // along a random open direction is zero is bounded; a bounded signal with a constant gradient closes a direction.
  // Parameters have the numbers of the file.
  class Conclusions {
    constructor(of, signs, strict) {
      const size = SIZES[0], p = randomPrime(size);
      Object.assign(this, { of, g: of.graph, signs, strict, p, size, linear: [], pool: [], tried: new Map() });
      const first = new Point(of, p, size, new Map()), given = first.given;
      for (const { label, kind } of of.symbols.filter((item) => CONSTANT.includes(item.kind))) {
        for (const k of of.inputs(label)) {
          const [low, high] = of.known.get(k) ?? [zeroQ, minusOne];
          given.set(k, less(low, high) || less(high, low) ? first.random() : first.residue(low));
        }
      }
      this.given = given;
      this.columns = of.symbols.filter((item) => ["state", "time"].includes(item.kind)).flatMap((item) => of.inputs(item.label));
      this.closed = new Echelon(p);
      this.points = [0, 1].map(() => new Point(of, p, size, given, true));
      this.inverse = (x) => first.inverse(x);
      this.count = 4 + of.conclusions.filter((x) => x.vector !== undefined && x.says === "goes to zero").reduce((n, x) => n + of.vector(x.vector).length, 0);
      this.span = new Echelon(p); // of all signals that vanish, at the points of the pool
      this.close();
    }
    add(row) {
      const grown = this.closed.add(row, this.inverse);
      if (grown) this.u = null;
      return grown;
    }
    direction() {
      this.u ??= new Map(this.closed.open(this.columns.length, () => below(this.p, this.size)).map((x, k) => [this.columns[k], x]));
      return this.u;
    }
    sample(nodes, count) {
      while (this.pool.length < count) this.pool.push(new Point(this.of, this.p, this.size, this.given));
      return this.pool.slice(0, count).map((point) => point.at(nodes));
    }
    equal(x, y) {
      return x.length === y.length && !y.includes(NONE) && this.sample([...x, ...y], 2).every((row) => row.every((value, k) => value === row[(k + x.length) % row.length]));
    }
    // Corrections of projections are bounded where their nominal rates are.
    bounded(nodes, within = []) {
      if (nodes.includes(NONE) || this.points[0].along(nodes, this.direction()).some((x) => x)) return false;
      const reads = this.g.reads(nodes), own = within[within.length - 1];
      return this.of.projections.every(({ state, correction }) => {
        if (state === own || !reads.has(this.of.places.get(correction))) return true;
        return !within.includes(state) && this.bounded(this.of.next(state), [...within, state]);
      });
    }
    close() {
      const { of, columns } = this, signals = [], waiting = [...of.linear];
      for (const term of this.strict) if (term.role === "stored") signals.push(...(term.matrix ?? term.vector));
      for (const item of of.projections) for (const k of of.inputs(item.state)) this.add(columns.map((x) => BigInt(x === k)));
      this.closeConstants();
      for (;;) {
        while (this.grow(signals));
        const found = waiting.find((item) => this.stable(item) && this.bounded(this.disturbance(item)));
        if (!found) return;
        waiting.splice(waiting.indexOf(found), 1);
        this.linear.push(found);
        signals.push(...found.vectors.flatMap((k) => of.vector(k)));
      }
    }
    // A combination of states whose rate is identically zero is constant.
    closeConstants() {
      const { g, of, columns } = this;
      const free = columns.filter((k, at) => !this.closed.rows.has(at) && of.moves.has(g.a[k])), rates = free.map((k) => of.moves.get(g.a[k])[g.b[k]]);
      const rows = new Echelon(this.p);
      for (const row of this.sample(rates, free.length + 3)) rows.add(row, this.inverse);
      free.forEach((_, at) => {
        if (rows.rows.has(at)) return;
        const u = rows.open(free.length, (k) => BigInt(k === at));
        this.add(columns.map((k) => (free.includes(k) ? u[free.indexOf(k)] : 0n)));
      });
    }
    grow(signals) {
      const [one, other] = this.points.map((point) => point.along(signals, this.direction()));
      const steady = signals.filter((_, k) => one[k] && one[k] === other[k]);
      return steady.map((node) => {
        const slope = this.points[0].gradient(node);
        return this.add(this.columns.map((k) => slope.get(k) ?? 0n));
      }).some((x) => x);
    }
    // dz/dt - A z of a linear equation.
    disturbance(item) {
      const { g, of } = this, z = item.vectors.map((k) => of.vector(k));
      return z.flatMap((vector, i) => {
        const row = item.rates[i].map((k, j) => spread(of.vector(k), z[j].length));
        need(row.length === z.length && item.rates.length === z.length && z.every((x) => x.length === vector.length), "a linear equation: its sizes");
        return of.rates(vector).map((rate, k) => (rate === NONE ? NONE : row.reduce((x, factor, j) => g.sub(x, g.mul(factor[k], z[j][k])), rate)));
      });
    }
    // True if dz/dt = A z is exponentially stable for each joint: one or two equations, over all intervals.
    stable(item) {
      const { of, signs } = this, n = Math.max(...item.vectors.map((k) => of.vector(k).length));
      const nodes = item.rates.map((row) => row.map((k) => spread(of.vector(k), n)));
      const moving = this.g.slice(nodes.flat(2)).some((k) => signs.boxes.has(k)), A = nodes.map((row) => row.map((x) => signs.bounds(x, signs.boxes)));
      if (A.flat().includes(null) || A.some((row) => row.length !== A.length) || A.length > (moving ? 1 : 2)) return false;
      return Array.from({ length: n }, (_, k) => A.map((row) => row.map((x) => x[k]))).every(([[a, b], [c, d] = []]) => {
        if (A.length === 1) return a[1][0] < 0n;
        return plusI(a, d)[1][0] < 0n && positive(minusI(timesI(a, d), timesI(b, c))[0]);
      });
    }
    made(nodes, span = this.span) {
      return !nodes.includes(NONE) && transposed(this.sample(nodes, this.count)).every((column) => span.has(column));
    }
    collect(nodes, span) { for (const column of transposed(this.sample(nodes, this.count))) span.add(column, this.inverse); }
    // Its square is integrable and its derivative bounded (Barbalat's lemma), it is the derivative of a vanishing signal
    // and its own derivative is bounded, or it follows from others.
    vanishes(nodes, squares, gone) {
      const { of } = this;
      const first = squares.some((x) => this.equal(nodes, x)) || gone.some((x) => this.equal(nodes, of.rates(x)));
      if (first && this.bounded(of.rates(nodes))) return true;
      if (!gone.length) return false;
      if (this.linear.some((item) => item.vectors.some((k) => this.equal(nodes, of.vector(k))) && this.made(this.disturbance(item)))) return true;
      const widths = of.terms.filter((term) => term.rule === "potential" && this.equal(nodes, term.vector)).map((term) => term.width);
      return [null, ...widths].some((width) => this.followsFrom(nodes, gone, width));
    }
    // True if a, or a / sqrt(1 + (a / v)^2) with the same zeros, is made of vanishing signals z; or R'a is, or a is part
    // of the least-squares solutions of R'b = z, with a matrix R that is believed to keep full row rank.
    followsFrom(nodes, gone, width) {
      const { g, of } = this, v = width && spread(width, nodes.length), a = width ? nodes.map((x, k) => g.div(x, root(g, x, v[k]))) : nodes;
      if (this.made(a)) return true;
      return of.ranks.some((item) => {
        const flat = of.vector(item.matrix), rows = of.rows[item.matrix], R = matrix(flat, rows), columns = flat.length / rows;
        const rank = new Echelon(this.p), [values] = this.sample(flat, 1);
        if (!matrix(values, rows).every((row) => rank.add(row, this.inverse))) return false;
        const shown = rows === a.length ? this.made(transposed(R).map((column) => g.dot(column, a))) : rows > a.length && gone.some((z) => {
          if (z.length % columns) return false;
          const span = new Echelon(this.p), square = g.matmul(R, transposed(R));
          for (let k = 0; k < z.length; k += columns) {
            this.collect(g.solve(square, R.map((row) => [g.dot(row, z.slice(k, k + columns))])).flat(), span);
          }
          return this.made(a, span);
        });
        if (shown) this.signs.believed.push(`${item.name} keeps full row rank, uniformly`);
        return shown;
      });
    }
    check() {
      const { of } = this, left = [...of.conclusions], shown = [], gone = [];
      const squares = [...this.strict].filter((term) => term.role === "dissipated" && term.rule === "square").map((term) => term.vector);
      for (;;) {
        const found = left.find((item) => {
          if (item.vector === undefined || this.tried.get(item) === gone.length) return false;
          this.tried.set(item, gone.length);
          return this.follows(item.says, of.vector(item.vector), squares, gone);
        });
        if (!found) return [shown, left];
        shown.push(...left.splice(left.indexOf(found), 1));
        if (found.says !== "goes to zero") continue;
        gone.push(of.vector(found.vector));
        this.collect(of.vector(found.vector), this.span);
      }
    }
    follows(says, nodes, squares, gone) {
      if (says === "is bounded") return this.bounded(nodes);
      if (says === "is square-integrable") return squares.some((x) => this.equal(nodes, x));
      if (says === "stays in a compact set of positive definite matrices") return [...this.strict].some((term) => term.matrix && this.equal(nodes, term.matrix));
      return says === "goes to zero" && this.vanishes(nodes, squares, gone);
    }
  }

  // What the lemmas of update steps show, whatever the rows are; eta is what the true parameters do not explain.
  const fromSteps = ({ estimate: name, rule, box }) => [
    ...(box ? [`${name} is bounded`] : []),
    `|${name} - true value|^2 in the metric ${rule === "normalised" ? "gain^-1" : "G + gain^-1"} does not rise where eta is zero`,
    `the error of ${name} in the direction of its rows is square-summable where eta is`,
  ];

  function proved(data) {
    const of = new Certificate(data), signs = new Signs(of), [error, points] = identity(of), strict = signs.check(), kappa = signs.kappa(strict);
    const named = (items) => items.map((item) => `${item.signal} ${item.says}`);
    let shown = [], left = of.conclusions;
    if (of.samples) left = left.filter((item) => item.estimate === undefined);
    else if (!of.terms.some((term) => term.role === "residual")) {
      [shown, left] = new Conclusions(of, signs, strict).check();
      const [again] = new Conclusions(of, signs, strict).check(); // with another prime
      left.push(...shown.filter((item) => !again.includes(item)));
      shown = shown.filter((item) => again.includes(item));
    }
    const given = of.samples ? [] : of.symbols.filter((item) => item.kind === "trajectory").map((item) => item.label);
    return {
      status: "re-proved",
      statement: of.samples ? "V(next) - V" : "dV/dt",
      log2_error: Math.round(error),
      points,
      robot: of.masses.map((item) => `a weight is the mass matrix of a chain of ${item.joints.length} rigid bodies${item.motion ? "; its acceleration follows from the torque, for all masses" : ""}`),
      kappa_above: kappa,
      only_at_exact_values_of: of.fixed.sort(),
      conclusions: of.samples ? of.steps.flatMap(fromSteps) : named(shown),
      believed: [...BELIEVED, ...(given.length ? [`bounded: ${given.join(", ")}`] : []), ...new Set(signs.believed), ...named(left)],
      assumed: of.assumed,
    };
  }

  // The result of the check of a parsed file; `status` is re-proved, refuted or refused, the latter two with a `reason`.
  function check(data) {
    try {
      return proved(data);
    } catch (fault) {
      if (fault instanceof Refuted) return { status: "refuted", reason: fault.message };
      return { status: "refused", reason: fault instanceof Refused ? fault.message : `${fault.name}: ${fault.message}` };
    }
  }
  return { check };
})();

if (typeof module === "object" && typeof require === "function") {
  module.exports = globalThis.checker;
  if (require.main === module) {
    const paths = process.argv.slice(2).filter((x) => x !== "--json");
    let result = { status: "refused", reason: "usage: node check.js FILE [--json]" };
    try {
      if (paths.length === 1) result = globalThis.checker.check(JSON.parse(require("fs").readFileSync(paths[0], "utf8")));
    } catch (fault) {
      result.reason = String(fault.message);
    }
    if (process.argv.includes("--json")) console.log(JSON.stringify(result, null, 1));
    else for (const [name, value] of Object.entries(result)) console.log(`${name.replaceAll("_", " ")}:`, Array.isArray(value) ? value.map((x) => `\n  ${x}`).join("") : value);
    process.exitCode = { "re-proved": 0, refuted: 1, refused: 2 }[result.status];
  }
}
