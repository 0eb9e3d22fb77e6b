// Checks the certificate of a control loop: node check.js FILE [--json], or checker.check(data) in a browser.
//
// It shares no code with dmframe or with check.py, and is built in another way: program, derivatives, robot and rules
// become one directed graph of sums, products, inverses and functions of symbols. The graph is then evaluated in random
// prime fields, bounded in degree, and evaluated in intervals. docs/explanation/checker.md proves each rule.
//
// Exit status: 0 re-proved, 1 refuted, 2 refused (no valid certificate, or a rule that this program does not know).
globalThis.checker = (() => {
  class Refused extends Error {}
  class Refuted extends Error {}
  class Undecided extends Refused {}
  const fail = (text, Fault = Refused) => { throw new Fault(text); }, refute = (text) => fail(text, Refuted);
  const need = (condition, text) => condition || fail(text);

  const WANTED = -300, SIZES = [149, 269, 521]; // log2 of the largest error, and bits of primes
  const LARGEST = 1e6, WIDEST = 1000, ROWS = 300, BIG = 1n << 20000n; // sizes of lists, bases, matrices and numbers
  const KINDS = ["constant", "given", "time", "state", "correction"];
  const BOUNDED = "sin cos tanh atan atan2 sign lt le eq not and".split(" ");
  const UNARY = "sin cos tanh atan sqrt exp log fabs sign floor not".split(" ");
  const CALLS = [...UNARY, ..."fmin fmax lt le eq and if_else_zero atan2".split(" ")], PLAIN = ["const", "input", "add", "sub", "mul", "div"];
  const ASSUMED = [
    "names, rates and next values are those of the loop that runs, and its solutions exist for all time",
    "divisors, those of derivatives too, and arguments of logarithms stay away from 0; arguments of roots are positive",
  ];

  // ---- Rational numbers [numerator, denominator > 0], and intervals [lower, upper] of them

  function fraction(n, d = 1n) {
    if (d < 0n) [n, d] = [-n, -d];
    let [a, b] = [n < 0n ? -n : n, d];
    while (b) [a, b] = [b, a % b];
    if (d / a > BIG || n / a > BIG || n / a < -BIG) fail("size", Undecided);
    return [n / a, d / a];
  }
  const sum = (x, y) => fraction(x[0] * y[1] + y[0] * x[1], x[1] * y[1]);
  const product = (x, y) => fraction(x[0] * y[0], x[1] * y[1]);
  const less = (x, y) => x[0] * y[1] < y[0] * x[1];
  const least = (all) => all.reduce((x, y) => (less(y, x) ? y : x));
  const most = (all) => all.reduce((x, y) => (less(x, y) ? y : x));
  const positive = (x) => x[0] > 0n;
  const zeroQ = [0n, 1n], exact = (a) => a[0] === a[1], point = (x) => [x, x]; // an exact interval has one number, twice
  const plusI = (a, b) => (exact(a) && exact(b) ? point(sum(a[0], b[0])) : [sum(a[0], b[0]), sum(a[1], b[1])]);
  const timesI = (a, b, same) => {
    if (exact(a) && exact(b)) return point(product(a[0], b[0]));
    const ends = a.flatMap((x) => b.map((y) => product(x, y)));
    return [same ? most([zeroQ, least(ends)]) : least(ends), most(ends)];
  };
  const negQ = ([n, d]) => [-n, d], negI = (a) => (exact(a) ? point(negQ(a[0])) : [negQ(a[1]), negQ(a[0])]), minusI = (a, b) => plusI(a, negI(b));
  const inverseQ = ([n, d]) => fraction(d, n);
  const inverseI = (a) => (positive(a[0]) || a[1][0] < 0n ? (exact(a) ? point(inverseQ(a[0])) : [inverseQ(a[1]), inverseQ(a[0])]) : null);

  function rational(text) {
    need(typeof text === "string" && text.length < 4000 && /^-?\d+(\/0*[1-9]\d*)?$/.test(text), `no fraction: ${text}`);
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
        need(k < LARGEST, "size");
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
    call(name, x, y = 0) { return this.node(CALL + CALLS.indexOf(name), x, UNARY.includes(name) ? 0 : y); }
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
      return op < ADD ? k : op < CALL ? this[["add", "sub", "mul", "inv"][op - ADD]](x, y) : this.call(this.name(k), x, y);
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
      const divisor = { "atan": this.add(ONE, this.mul(x, x)), "sqrt": this.add(k, k), "log": x }[name];
      return name === "exp" ? k : divisor ? this.inv(divisor) : NONE;
    }
    dot(x, y) {
      need(x.length === y.length, "size");
      return x.reduce((total, a, k) => this.add(total, this.mul(a, y[k])), ZERO);
    }
    minus(x, y) { return this.pairs("sub", x, y); }
    plus(x, y) { return this.pairs("add", x, y); }
    times(x, y) { return this.pairs("mul", x, y); }
    pairs(name, x, y) {
      need(x.length === y.length, "size");
      return x.map((a, k) => (this[name] ? this[name](a, y[k]) : this.call(name, a, y[k])));
    }
    matmul(X, Y) { return X.map((row) => Y[0].map((_, j) => this.dot(row, Y.map((line) => line[j])))); }
  }

  const matrix = (flat, rows) => Array.from({ length: rows }, (_, i) => flat.filter((_, k) => k % rows === i));
  const transposed = (rows) => rows[0].map((_, j) => rows.map((row) => row[j]));

  // ---- The file

  const LISTS = {
    "symbols": "label kind size numbers exact", "terms": "name role rule parts assumed", "robots": "position joints rotors gravity torque",
    "stable": "vector weight loss", "ranks": "name matrix vector", "conditions": "name margin strict", "conclusions": "signal says vector",
  };
  const TOP = `format version about over program vectors rates assumed ${Object.keys(LISTS).join(" ")}`, FLOW = ["robots", "stable", "ranks"];
  const PHI = "vector other scale weight", PARTS = {
    "square": "vector weight", "potential": "vector scale weight", "tanh": PHI, "atan": PHI, "projected": "vector correction true lower upper weight",
  };
  const VECTORS = { "robots": "rotors gravity torque", "stable": "vector weight loss", "ranks": "matrix vector", "conditions": "margin", "conclusions": "vector" };
  const ROLES = { "stored": ["square", "potential"], "dissipated": ["square", "tanh", "atan", "projected"], "residual": ["square"] };

  function keys(item, text, names) {
    const must = names.split(" "), wrong = [...Object.keys(item).filter((x) => !must.includes(x)), ...must.filter((x) => !Object.hasOwn(item, x))];
    need(!wrong.length, `${text}: missing or unknown: ${wrong}`);
    for (const name of ["name", "signal", "says", "label"]) if (must.includes(name)) (name === "says" || text === "conditions" ? printable : named)(item[name]);
    for (const name of ["exact", "strict"]) need(!must.includes(name) || typeof item[name] === "boolean", name);
    return item;
  }
  const printable = (x) => (typeof x === "string" && /^[ -~]*$/.test(x) ? x : fail("a text")); // letters of two alphabets may look alike
  const named = (x) => (/^\S(.*\S)?$/.test(printable(x)) && !/^.*\b(is|are|goes)\b/.test(x) ? x : fail(`a name: ${x}`)); // it must not read as a statement
  const distinct = (names) => need(new Set(names).size === names.length, "a name of two signals, conditions, assumed weights, boxes or matrices");
  const whole = (x, from = 0, to = LARGEST) => {
    need(Number.isSafeInteger(x) && from <= x && x < to, `no number: ${x}`);
    return x;
  };
  const at = (items, k) => items[whole(k, 0, items.length)];
  const list = (x) => (Array.isArray(x) && x.length < LARGEST ? x : fail("no list"));

  class Certificate {
    constructor(data) {
      need(data?.format === "dmframe-certificate" && data.version === 4 && ["flow", "sample"].includes(data.over), "version: expected 4; write the file again");
      this.samples = data.over === "sample";
      keys(data, "the file", TOP);
      for (const own of [data.about, data.rates]) need(typeof own === "object" && own && !Array.isArray(own), "expected an object");
      need(Object.values(data.about).every((x) => typeof x === "string"), "about: expected texts");
      for (const [name, own] of Object.entries(LISTS)) this[name] = list(data[name]).map((item) => keys(item, name, own));
      need(!this.samples || FLOW.every((name) => !this[name].length), `a rule over a ${data.over}`);
      for (const names of [this.conclusions.map((x) => `${x.signal} ${x.says}`), this.conditions.map((x) => x.name), this.terms.filter((x) => x.assumed).map((x) => x.name)]) distinct(names);
      this.graph = new Graph();
      this.places = new Map(this.symbols.map((item, k) => [item.label, k]));
      need(this.places.size === this.symbols.length, "symbols");
      this.known = new Map(); // intervals of input nodes
      this.divided = [];
      this.fixed = this.symbols.filter((item) => item.exact).map((item) => item.label);
      for (const item of this.symbols) this.readSymbol(item);
      need(this.symbols.reduce((total, { size }) => total + size, 0) < LARGEST, "size");
      const nodes = [ZERO, ...this.readProgram(keys(data.program, "program", "operations code a b constants"))];
      this.vectors = list(data.vectors).map((elements) => {
        need(list(elements).length, "an empty vector");
        return elements.map((k) => nodes[whole(k, -1, nodes.length - 1) + 1]);
      });
      this.assumed = data.assumed.map(printable);
      this.moves = new Map(Object.entries(data.rates).map(([label, k]) => {
        const item = this.symbol(label), given = ["constant", "given", "time"];
        need(this.vector(k).length === item.size, `the rate of ${label}`);
        need(item.kind === "state" || (!this.samples && item.kind === "given" && this.of(this.vector(k), given)), `the rate of ${label}`);
        return [this.places.get(label), this.vector(k)];
      }));
      this.terms = this.terms.map((item) => this.readTerm(item));
      for (const [name, own] of Object.entries(VECTORS)) this[name] = this[name].map((item) => this.withVectors(item, own, ["conditions", "conclusions"].includes(name)));
      for (const { vector: { length: n }, weight, loss } of this.stable) need([weight, loss].every((x) => [n, n * n].includes(x.length)), "a linear equation: its sizes");
      this.robots = this.robots.map((item) => ({ ...item, joints: list(item.joints).map((own) => this.readJoint(own)) }));
      const boxes = this.terms.filter((x) => x.rule === "projected").map((x, k) => [x.name, [x["true"], x.lower, x.upper, this.samples || k]]);
      const signals = [...this.symbols.map((x) => [x.label, this.inputs(x.label)]), ...this.conclusions.filter((x) => x.vector).map((x) => [x.signal, x.vector])];
      for (const pairs of [signals, this.ranks.map((x) => [x.name, x.matrix]), boxes]) distinct([...new Set(pairs.map(([name, own]) => `${own} ${name}`))].map((text) => text.slice(text.indexOf(" "))));
      this.derivatives = new Map();
      const moved = this.terms.flatMap((item) => item.correction ?? []);
      need(this.samples || new Set(moved).size === moved.length, "a correction occurs twice");
      need(this.terms.some((item) => item.role === "stored"), "V");
    }
    readSymbol({ label, kind, size, numbers, exact }) {
      need(KINDS.includes(kind) && whole(size, 1) &&
        (numbers === null ? !exact : kind === "constant" && list(numbers).length === size), `${label}: its numbers`);
      numbers?.forEach((pair, k) => {
        const ends = pair.map(rational), [low, high] = ends.map(String);
        need(ends.length === 2 && !less(ends[1], ends[0]) && (low === high || !exact), `${label}: its numbers`);
        this.known.set(this.graph.input(this.places.get(label), k), low === high ? point(ends[0]) : ends);
      });
    }
    readProgram({ operations, constants, code, a, b }) {
      const g = this.graph, numbers = list(constants).map(rational), nodes = [];
      need(list(operations).every((x) => PLAIN.includes(x) || CALLS.includes(x)), "unknown operation");
      for (const column of [code, a, b]) for (const k of list(column)) whole(k);
      need([a, b].every((x) => list(x).length === code.length), "size");
      list(code).forEach((k, i) => {
        const name = at(operations, k);
        if (name === "const") nodes.push(g.number(at(numbers, a[i])));
        else if (name === "input") nodes.push(g.input(a[i], whole(b[i], 0, at(this.symbols, a[i]).size)));
        else {
          const [x, y] = [a, b].map((column) => at(nodes, column[i]));
          nodes.push(CALLS.includes(name) ? g.call(name, x, y) : g[name](x, y));
          if (name === "div") this.divided.push(g.inv(y)); // a divisor must not vanish, even in a part times 0
        }
      });
      return nodes;
    }
    readTerm(item) {
      const { name, role, rule, assumed } = item;
      need(typeof role === "string" && Object.hasOwn(ROLES, role) && ROLES[role].includes(rule) && (!this.samples || ["square", "projected"].includes(rule)), `${name}: unknown rule ${rule} of a ${role} term`);
      keys(item.parts, "parts", PARTS[rule]);
      if (assumed !== null) printable(assumed);
      return { name, role, rule, assumed, ...this.withVectors(item.parts, PARTS[rule]) };
    }
    // The item with nodes in place of the numbers of its vectors.
    withVectors(item, names, optional = false) {
      return { ...item, ...Object.fromEntries(names.split(" ").map((x) => [x, optional && item[x] === null ? null : this.vector(item[x])])) };
    }
    readJoint(item) {
      need(["revolute", "prismatic"].includes(keys(item, "a joint", "kind axis place body").kind), "a joint");
      return this.withVectors(item, "axis place body");
    }
    symbol(label) { return this.symbols[this.places.get(label) ?? fail(label)]; }
    inputs(label) { return Array.from({ length: this.symbol(label).size }, (_, k) => this.graph.input(this.places.get(label), k)); }
    vector(k) { return at(this.vectors, k); }
    kind(k) { return this.graph.op[k] === INPUT ? this.symbols[this.graph.a[k]].kind : ""; }
    // True if these depend on symbols of these kinds alone.
    of(nodes, kinds) { return [...this.graph.reads(nodes)].every((k) => kinds.includes(this.symbols[k].kind)); }
    next(k) { return this.moves.get(this.graph.a[k])?.[this.graph.b[k]] ?? fail("a rate"); }
    // The derivative of a node, or the difference to its next value.
    change(node) {
      const g = this.graph;
      if (!this.samples) return this.exactRates([node])[0];
      return g.sub(g.replaced([node], (k) => (this.kind(k) === "constant" ? k : this.next(k)))[0], node);
    }
    // Derivatives; NONE where there is none, or of a symbol without a rate.
    rates(nodes) {
      const g = this.graph;
      return g.rates(nodes, (k) => {
        const { kind } = this.symbols[g.a[k]], rate = this.moves.get(g.a[k]);
        return rate ? rate[g.b[k]] : kind === "time" ? ONE : kind === "constant" ? ZERO : NONE;
      }, this.derivatives);
    }
    exactRates(nodes) {
      const found = this.rates(nodes);
      need(!found.includes(NONE), "no derivative");
      return found;
    }
  }

  // ---- Terms and the identity

  function weighted(g, weight, vector) {
    const n = vector.length, rows = weight.length === n ? null : matrix(weight, n);
    need(!rows || weight.length === n * n, "size");
    return vector.map((x, k) => (rows ? g.dot(rows[k], vector) : g.mul(weight[k], x)));
  }

  const symmetric = (g, rows) => rows.map((row, i) => row.map((x, k) => g.mul(g.number([1n, 2n]), g.add(x, rows[k][i]))));

  function termValue(of, term) {
    const g = of.graph, { rule, vector: a, weight: w, scale: v } = term, scaled = (x) => x.map((x, k) => g.div(x, at(v, k)));
    need(!v || v.length === a.length, "size");
    if (rule === "square") return g.dot(a, weighted(g, w, a));
    if (rule === "projected") { // -w (x - true) c
      const { correction: c } = term, x = of.samples ? g.plus(a, c) : a;
      return g.neg(g.dot(w, g.times(g.minus(x, term["true"]), c)));
    }
    if (rule === "potential") { // sum 2 w v^2 (sqrt(1 + (a / v)^2) - 1)
      const gains = v.map((v, k) => g.mul(g.mul(v, v), g.sub(root(g, a[k], v), ONE)));
      return g.dot(w, gains.map((x) => g.add(x, x)));
    }
    // sum w (a - b) (phi(a / v) - phi(b / v))
    const phi = [a, term.other].map((x) => scaled(x).map((x) => g.call(rule, x)));
    return g.dot(w, g.times(g.minus(a, term.other), g.minus(...phi)));
  }
  const root = (g, x, v) => g.call("sqrt", g.add(ONE, g.mul(g.div(x, v), g.div(x, v))));

  const clipped = (g, { vector, lower, upper }) => g.pairs("fmin", g.pairs("fmax", vector, lower), upper);

  // What a projection adds to the rates of estimates; over samples, what moves values into their box.
  function corrected(of, { vector, correction, lower, upper }) {
    const g = of.graph;
    if (of.samples) return g.minus(clipped(g, { vector, lower, upper }), vector);
    need(vector.every((k) => of.kind(k) === "state") && correction.every((k) => of.kind(k) === "correction"), "a projection");
    need(of.of([...lower, ...upper], ["constant"]), "a box that moves");
    return g.minus(vector.map((k) => of.next(k)), nominal(of, vector, correction));
  }
  // Rates of estimates without the corrections of their projection.
  const nominal = (of, vector, correction) => of.graph.replaced(vector.map((k) => of.next(k)), (k) => (correction.includes(k) ? ZERO : k));

  // Names and nodes that must vanish; the first one is V, which must not.
  function equalities(of) {
    const g = of.graph, half = g.number([1n, 2n]), found = of.robots.flatMap((item) => robot(of, item));
    let V = ZERO, total = ZERO;
    for (const term of of.terms) {
      const value = termValue(of, term);
      if (term.role === "stored") {
        V = g.add(V, value);
        total = g.add(total, g.mul(half, of.change(value)));
      } else total = g[term.role === "dissipated" ? "add" : "sub"](total, value);
      if (term.rule === "projected") found.push([`the correction of ${term.name}`, g.minus(corrected(of, term), term.correction)]);
    }
    return [["V", [V]], [of.samples ? "V(next) - V" : "dV/dt", [total]], ...found];
  }

  // A chain of rigid bodies in homogeneous coordinates: T places link i in the world, and its pseudo-inertia S is the
  // integral of r r' dm over the points r = (x, y, z, 1) of the link. With the Jacobian U_j = dT/dq_j and its rates, V the
  // rate of T and C its acceleration less gravity, the force of joint j is sum_i tr(U_j S C'), by d'Alembert's principle.
  function robot(of, item) {
    const g = of.graph, { rotors, gravity, torque } = item, q = of.inputs(item.position), n = q.length, dq = of.exactRates(q), found = [];
    if (new Set([...q, ...dq].filter((k) => of.kind(k) === "state")).size < 2 * n) refute("positions and speeds of the robot: expected states");
    const ddq = of.exactRates(dq);
    need(n && of.of([...rotors, ...gravity], ["constant"]) && item.joints.length === n && rotors.length === n && gravity.length === 3, "size");
    const scaled = (X, factor) => X.map((row) => row.map((x) => g.mul(x, factor)));
    const plus = (...all) => all.reduce((X, Y) => X.map((row, i) => row.map((x, j) => g.add(x, Y[i][j]))));
    const rows = (column) => [0, 1, 2].map((i) => [0, 1, 2, 3].map((j) => (column ? (j === 3 ? g.neg(column[i]) : ZERO) : i === j ? ONE : ZERO)));
    const sums = Array(n).fill(ZERO);
    let T = rows(), V = rows([ZERO, ZERO, ZERO]), C = rows(gravity), U = [];
    item.joints.forEach((own, i) => {
      const { A, K, S, zeros } = joint(of, own, q[i]), moved = g.matmul(V, A);
      found.push(...zeros);
      T = g.matmul(T, A);
      U = [...U.map((X) => g.matmul(X, A)), g.matmul(T, K)];
      V = plus(moved, scaled(U[i], dq[i]));
      C = plus(g.matmul(C, A), g.matmul(scaled(plus(moved, V), dq[i]), K), scaled(U[i], ddq[i]));
      const inertial = g.matmul(C, S).flat();
      U.forEach((X, j) => { sums[j] = g.add(sums[j], g.dot(X.flat(), inertial)); });
    });
    return [...found, ["the robot's equation of motion", g.minus(sums.map((x, i) => g.add(x, g.mul(rotors[i], ddq[i]))), torque)]];
  }

  // The transform A of a joint, K with dA/dq = A K, its body, and what must vanish.
  function joint(of, item, q) {
    const g = of.graph, { axis: a, place, body } = item, [x, y, z] = a, turns = item.kind === "revolute";
    need(a.length === 3 && place.length === 12, "a joint");
    const P = matrix(place, 3), R = P.map((row) => row.slice(0, 3)), dots = (X, Y) => X.flatMap((x, i) => Y.map((y, j) => g.sub(g.dot(x, y), i === j ? ONE : ZERO)));
    const minor = (k, [i, j] = [(k + 1) % 3, (k + 2) % 3]) => g.sub(g.mul(R[0][i], R[1][j]), g.mul(R[0][j], R[1][i]));
    const K = turns ? [[ZERO, g.neg(z), y, ZERO], [z, ZERO, g.neg(x), ZERO], [g.neg(y), x, ZERO, ZERO]] : a.map((e) => [ZERO, ZERO, ZERO, e]);
    K.push(Array(4).fill(ZERO));
    const moving = g.slice(place).filter((k) => k !== q && g.op[k] === INPUT);
    need(moving.every((k) => of.kind(k) === "constant") && of.of([...a, ...body], ["constant"]), "a joint");
    const A = [...P, [ZERO, ZERO, ZERO, ONE]], slopes = g.rates(P.flat(), (k) => (k === q ? ONE : ZERO), new Map());
    return {
      A, K, S: pseudo(body),
      zeros: [["a rotation and an axis", [...dots(R, R), ...dots([a], [a]), ...R[2].map((x, k) => g.sub(x, minor(k)))]], ["a joint's motion", g.minus(slopes, g.matmul(P, K).flat())]],
    };
  }
  const pseudo = (body) => [0, 1, 2, 3].map((i) => [0, 1, 2, 3].map((k) => at(body, Math.max(i, k) * (Math.max(i, k) + 1) / 2 + Math.min(i, k))));

  // ---- Degrees: bounds of a node's degree and height, of its numerator and of its denominator

  // The height is log2 of the sum of absolute coefficients. Bound D + H of the numerators that must vanish, and of those
  // that must not: of all divisors, and of the differences of all arguments of one function.
  function degrees(g, nodes, fixed) {
    const found = new Map(), callers = {}, add = (x) => x.reduce((a, b) => a + b, 0);
    let total = 0;
    for (const k of g.slice(nodes)) {
      const op = g.op[k], [x, y] = g.operands(k).map((x) => found.get(x));
      let own = [1, 0, 0, 0];
      if (op === NUMBER || fixed.has(k)) own = (fixed.get(k) ?? g.numbers[g.a[k]]).flatMap((n) => [0, n.toString(2).length]);
      else if (op === ADD || op === SUB) own = [Math.max(x[0] + y[2], y[0] + x[2]), Math.max(x[1] + y[3], y[1] + x[3]) + 1, x[2] + y[2], x[3] + y[3]];
      else if (op === MUL) own = x.map((a, i) => a + y[i]);
      else if (op === INV) {
        own = [x[2], x[3], x[0], x[1]];
        total += x[0] + x[1];
      } else if (op >= CALL) {
        const name = g.name(k), circle = /^(sin|cos)$/.test(name);
        (callers[circle ? "sin" : name] ??= new Set()).add(x).add(y ?? x);
        if (circle) own = [2, 1, 2, 1];
      }
      found.set(k, own);
    }
    for (const of of Object.values(callers)) total += of.size * add([...of].map((x) => add(x) + 4)); // x = y
    return total + add([0, 1].map((i) => nodes.reduce((most, k) => Math.max(most, found.get(k)[i]), 0)));
  }

  // ---- Prime fields

  const words = new Uint32Array(4096);
  let used = 4096;
  function bits(count) {
    let value = 0n;
    for (let k = 0; k < count; k += 32) {
      if (used === 4096) used = crypto.getRandomValues(words) && 0;
      value = (value << 32n) | BigInt(words[used++]);
    }
    return BigInt.asUintN(count, value);
  }
  const below = (p, size) => bits(size + 96) % p;
  function powered(x, n, p) {
    let value = 1n;
    for (; n; n >>= 1n, x = (x * x) % p) if (n & 1n) value = (value * x) % p;
    return value;
  }
  // A prime of which -1 is no square: p = 3 mod 4, by the test of Miller and Rabin with 64 random bases.
  function randomPrime(size) {
    for (;;) {
      const p = bits(size) | (1n << BigInt(size - 1)) | 3n;
      let k = 0;
      if ([3n, 5n, 7n, 11n, 13n, 17n, 19n, 23n, 29n, 31n, 37n].some((small) => p % small === 0n)) continue;
      while (k < 64 && [1n, p - 1n].includes(powered(below(p - 3n, size) + 2n, p >> 1n, p))) k++;
      if (k === 64) return p;
    }
  }

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
      if (a !== 1n) fail("a divisor vanishes", Undecided);
      return (s + this.p) % this.p;
    }
    residue([n, d]) { return ((n % this.p + this.p) * (d === 1n ? d : this.inverse(d % this.p))) % this.p; }
    at(nodes) {
      const v = this.values;
      if (nodes.some((k) => v[k] === undefined)) for (const k of this.g.slice(nodes)) v[k] ??= this.value(k);
      return nodes.map((k) => v[k]);
    }
    value(k) {
      const { g, p, values } = this, op = g.op[k], x = values[g.a[k]], y = values[g.b[k]];
      switch (op) {
        case MUL: return (x * y) % p;
        case ADD: return (x + y) % p;
        case SUB: return (x - y + p) % p;
        case INV: return this.inverse(x);
        case NUMBER:
          if (!this.given.has(k)) this.given.set(k, this.residue(g.numbers[g.a[k]]));
          return this.given.get(k);
        case INPUT: return this.given.get(k) ?? this.random();
      }
      const name = g.name(k), own = this.frozen && BOUNDED.includes(name);
      if (name === "sin" || name === "cos") return this.turned(own ? `of ${g.a[k]}` : `at ${x}`)[name];
      return own ? this.random() : this.memo(`${name} ${x} ${UNARY.includes(name) ? "" : y}`);
    }
    turned(circle) {
      const { p, memory } = this;
      if (!memory.has(circle)) {
        const t = this.random(), scale = this.inverse((1n + t * t) % p);
        memory.set(circle, { cos: ((1n + (p - t) * t) * scale) % p, sin: (2n * t * scale) % p });
      }
      return memory.get(circle);
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
  }

  // log2 of the error bound and the number of points; refutes at a point where an equality does not hold.
  function identity(of) {
    const found = equalities(of), all = [...found, [0, of.vectors.flat()], [0, of.divided]].flatMap(([, nodes]) => nodes);
    const fixed = new Map(of.fixed.flatMap((label) => of.inputs(label)).map((k) => [k, of.known.get(k)[0]]));
    const total = Math.log2(degrees(of.graph, all, fixed)), size = SIZES.find((size) => total + 3 - size < -64);
    need(size, "size");
    const error = 3 + total - size, points = Math.ceil(WANTED / error);
    for (let k = 0; k < points; k++) {
      const point = new Point(of, randomPrime(size), size, new Map());
      for (const [k, value] of fixed) point.given.set(k, point.residue(value));
      point.at(all);
      for (const [name, nodes] of found) if (point.at(nodes).some((x) => x) === (name !== "V")) refute(`${name} does not hold`);
    }
    const last = new Point(of, randomPrime(size), size, new Map()); // no divisor vanishes with the file's numbers
    for (const [k, [low, high]] of of.known) if (String(low) === String(high)) last.given.set(k, last.residue(low));
    last.at(of.divided);
    return [points * error, points];
  }

  // ---- Signs, conditions and small gain

  class Signs {
    constructor(of) { Object.assign(this, { of, boxes: new Map(), assumed: [], strict: new Set() }); }
    // Intervals of nodes; null if they are not decided.
    bounds(nodes) {
      try {
        return this.intervals(nodes);
      } catch (fault) {
        if (fault instanceof Undecided) return null;
        throw fault;
      }
    }
    intervals(nodes) {
      const g = this.of.graph, found = new Map();
      for (const k of g.slice(nodes)) {
        const op = g.op[k], [a, b] = g.operands(k), [x, y] = [a, b].map((x) => found.get(x)), name = g.name(k);
        let own = null;
        if (op === NUMBER) own = [g.numbers[g.a[k]], g.numbers[g.a[k]]];
        else if (op === INPUT) own = this.of.known.get(k) ?? this.boxes.get(k);
        else if (op === ADD) own = plusI(x, y);
        else if (op === SUB) own = minusI(x, y);
        else if (op === MUL) own = timesI(x, y, a === b);
        else if (op === INV) own = inverseI(x);
        else if (name === "fabs") own = [most([zeroQ, x[0], negI(x)[0]]), most([x[1], negI(x)[1]])];
        if (!own) return null;
        found.set(k, own);
      }
      return nodes.map((k) => found.get(k));
    }
    // 1 if all elements, or a matrix, are positive, 0 if none is negative, -1 otherwise or if not decided.
    sign(nodes, size = 0) {
      const values = this.bounds(size > 1 && nodes.length === size * size ? this.pivots(matrix(nodes, size)) : nodes);
      return values ? values.reduce((least, [[n]]) => Math.min(least, (n > 0n) - (n < 0n)), 1) : -1;
    }
    // Nodes that depend on numbers alone. What is assumed of a vector must hold for these.
    decided(nodes) {
      const { graph: g, known } = this.of, open = new Set();
      for (const k of g.slice(nodes)) {
        const own = g.op[k] === INPUT ? !known.has(k) && !this.boxes.has(k) : g.op[k] >= CALL && g.name(k) !== "fabs";
        if (own || g.operands(k).some((x) => open.has(x))) open.add(k);
      }
      return nodes.filter((k) => !open.has(k));
    }
    // A matrix is positive definite if all pivots of its symmetric part are positive.
    pivots(all) {
      need(all.length <= ROWS, "a matrix is too large");
      const g = this.of.graph, found = [];
      let rows = symmetric(g, all);
      while (rows.length) {
        const [first, ...rest] = rows;
        found.push(first[0]);
        rows = rest.map((row) => row.slice(1).map((x, k) => g.sub(x, g.mul(g.div(row[0], first[0]), first[k + 1]))));
      }
      return found;
    }
    // True for a term that is not negative; `strict` collects those with a positive weight.
    term(term) {
      const { rule, name, weight, scale, assumed, vector } = term;
      const n = vector.length, wide = rule === "square" && weight.length === n * n, decided = assumed ? this.decided(weight) : weight;
      let sign = this.sign(weight, rule === "square" ? n : 0);
      if (assumed && decided.length < weight.length) {
        this.assumed.push(`${name}: its weight is uniformly positive: ${assumed}`);
        sign = this.sign(wide ? this.decided(weight.filter((_, k) => k % (n + 1) === 0)) : decided);
        if (sign < 1) refute(`${name}: its weight`);
      }
      if (sign < 0 || (scale && this.sign(scale) < 1)) refute(`${name}: its sign`);
      if (sign) this.strict.add(term);
      if (rule === "projected") this.inside(term);
    }
    inside({ name, vector, lower, upper, "true": inner }) {
      const { graph: g, samples } = this.of;
      let room = [...g.minus(inner, lower), ...g.minus(upper, inner)];
      if (this.decided(inner).length < inner.length) {
        this.assumed.push(`${name}: its true value is inside its box`);
        room = this.decided(room);
      }
      if (this.sign(g.minus(upper, lower)) < 0 || this.sign(room) < 0) refute(`${name}: its box`);
      if (samples) return;
      this.assumed.push(`${name}: it starts in its box, and its law is this projection`);
      const [low, high] = [lower, upper].map((x) => this.bounds(x) ?? refute(`${name}: its box`));
      vector.forEach((node, k) => {
        need(!this.boxes.has(node), `${name}: two boxes`);
        this.boxes.set(node, [low[k][0], high[k][1]]);
      });
    }
    // Checks all signs; returns the terms with a positive weight.
    check() {
      const { of } = this;
      for (const term of of.terms) if (term.role !== "residual") this.term(term);
      for (const { joints, rotors } of of.robots) {
        if (joints.some(({ body }) => this.sign(pseudo(body).flat(), 4) < 1) || this.sign(rotors) < 0) refute("a body of the robot");
      }
      for (const item of of.conditions) {
        const text = `condition: ${item.name}`, margin = item.margin ?? [], decided = this.decided(margin);
        if (!margin.length || decided.length < margin.length) this.assumed.push(text);
        if (this.sign(decided) < Number(item.strict)) refute(text);
      }
      return this.strict;
    }
  }

  // ---- Conclusions in continuous time

  // The directions in the span of a basis along which functionals vanish, from their slopes along each.
  function restricted(basis, slopes, p, inverse) {
    let rows = basis.map((u, k) => [...u, ...slopes[k]]);
    const n = basis[0]?.length ?? 0;
    for (let k = n; k < (rows[0]?.length ?? 0); k++) {
      const pivot = rows.find((row) => row[k]);
      if (!pivot) continue;
      const scale = p - inverse(pivot[k]);
      rows = rows.filter((row) => row !== pivot).map((row) => {
        const factor = (row[k] * scale) % p;
        return factor ? row.map((x, i) => (pivot[i] ? (x + factor * pivot[i]) % p : x)) : row;
      });
    }
    return rows.map((row) => row.slice(0, n));
  }
  const units = (n) => Array.from({ length: n }, (_, k) => Array.from({ length: n }, (_, i) => BigInt(i === k)));

  // Bounded and vanishing signals, if V does not increase and trajectories, with their rates, are bounded. A direction of
  // the space of states, corrections and time is open if no bounded signal determines it. With bounded functions frozen, a signal whose derivative
  // along a random open direction is zero is bounded; a bounded signal with constant derivatives closes a direction.
  // Parameters have the numbers of the file.
  class Conclusions {
    constructor(of, signs, strict) {
      const size = SIZES[1], p = randomPrime(size), first = new Point(of, p, size, new Map()), given = first.given;
      Object.assign(this, { of, g: of.graph, signs, strict, p, size, given, linear: [], pool: [], gone: [] });
      for (const { label, kind } of of.symbols) {
        for (const k of kind === "constant" ? of.inputs(label) : []) {
          const [low, high] = of.known.get(k) ?? [zeroQ, []];
          given.set(k, String(low) === String(high) ? first.residue(low) : first.random());
        }
      }
      this.columns = of.symbols.filter((item) => ["state", "time", "correction"].includes(item.kind)).flatMap((item) => of.inputs(item.label));
      need(this.columns.length <= WIDEST, "too many states");
      this.open = units(this.columns.length);
      this.points = [0, 1].map(() => new Point(of, p, size, given, true));
      this.inverse = (x) => first.inverse(x);
      this.squares = [...strict].filter((term) => term.role === "dissipated" && term.rule === "square").flatMap((term) => term.vector);
      this.wanted = of.conclusions.filter((item) => item.vector);
      this.bounds = [];
      this.sources = [];
      this.premises();
      while (this.bounds.map(([given, nodes]) => this.bounded(given) && !this.bounded(nodes) && this.grow(nodes)).some((x) => x));
      this.count = 4 + [...this.wanted.filter((x) => x.says === "goes to zero").map((x) => x.vector), ...this.sources.map((x) => x[1])].flat().length;
      need(this.count <= WIDEST, "too many vanishing signals");
      this.basis = units(this.count);
    }
    dot(x, y) { return x.reduce((total, a, k) => (a && y[k] ? (total + a * y[k]) % this.p : total), 0n); }
    along(nodes, u, place = 0) { return this.points[place].along(nodes, new Map(u.map((x, k) => [this.columns[k], x]))); }
    sample(nodes, count) {
      while (this.pool.length < count) this.pool.push(new Point(this.of, this.p, this.size, this.given));
      return this.pool.slice(0, count).map((point) => point.at(nodes));
    }
    // True if each of these nodes is one of the others.
    among(nodes, others) {
      const columns = (x) => transposed([x, ...this.sample(x, 2)]).map(([, ...values]) => String(values));
      const known = others.filter((x) => x !== NONE), values = known.length ? columns(known) : [];
      return columns(nodes).every((x) => values.includes(x));
    }
    bounded(nodes) {
      const weights = this.open.map(() => below(this.p, this.size)), u = this.columns.map((_, k) => this.dot(weights, this.open.map((x) => x[k])));
      return !nodes.includes(NONE) && !this.along(nodes, u).some((x) => x);
    }
    restrict(slopes) {
      const before = this.open.length;
      this.open = restricted(this.open, slopes, this.p, this.inverse);
      return this.open.length < before;
    }
    grow(nodes) {
      const [one, other] = [0, 1].map((place) => this.open.map((u) => this.along(nodes, u, place)));
      return this.restrict(one.map((row) => row.filter((_, k) => one.every((x, i) => x[k] === other[i][k]))));
    }
    // Where the first signals of `bounds` are bounded, the second are; where those of `sources` vanish, too.
    premises() {
      const { g, of, signs, bounds, sources, columns, strict, p } = this;
      const boxed = new Set(of.terms.flatMap((x) => (x.rule === "projected" ? x.vector : [])));
      const moving = columns.filter((k) => of.moves.has(g.a[k]) && !boxed.has(k)), rows = this.sample(moving.map((k) => of.next(k)), moving.length + 3);
      // combinations of states whose rate is identically zero
      const steady = restricted(units(moving.length), moving.map((_, k) => rows.map((row) => row[k])), p, this.inverse);
      this.restrict(this.open.map((u) => steady.map((x) => this.dot(x, moving.map((k) => u[columns.indexOf(k)])))));
      for (const term of of.terms) {
        const { rule, role, vector: a, correction } = term;
        if (rule === "projected") bounds.push([[], a], [nominal(of, a, correction), correction]);
        if (role === "stored" && strict.has(term)) bounds.push([[], a]);
        if (rule === "potential") sources.push([a.map((x, k) => g.div(x, root(g, x, term.scale[k]))), a]); // it has the zeros of a
      }
      for (const item of of.stable) { // W dz/dt = - L z + force
        const { vector: z, weight, loss } = item, rate = of.rates(z), n = z.length;
        if (signs.sign(weight, n) < 1 || signs.sign(loss, n) < 1 || !of.of(weight, ["constant"]) || rate.includes(NONE)) continue;
        const metric = weight.length === n ? weight : symmetric(g, matrix(weight, n)).flat();
        const force = g.plus(weighted(g, metric, rate), weighted(g, loss, z));
        bounds.push([force, z]);
        sources.push([force, z]);
      }
      for (const item of of.ranks) {
        const { matrix: flat, vector: b } = item, n = b.length, R = matrix(flat, n), [values] = this.sample(flat, 1);
        need(flat.length % n === 0, "size");
        if (restricted(units(n), matrix(values, n), p, this.inverse).length) continue;
        sources.push([transposed(R).map((column) => g.dot(column, b)), b, `${item.name} keeps full row rank, uniformly`]);
      }
    }
    slopes(nodes) {
      const columns = transposed(this.sample(nodes, this.count));
      return this.basis.map((u) => columns.map((column) => this.dot(u, column)));
    }
    made(nodes) { return !nodes.includes(NONE) && !this.slopes(nodes).flat().some((x) => x); }
    vanish(nodes) {
      this.gone.push(nodes);
      this.basis = restricted(this.basis, this.slopes(nodes), this.p, this.inverse);
    }
    // Its square is integrable and its derivative bounded (Barbalat's lemma), it is the derivative of a vanishing signal
    // and its own derivative is bounded, or vanishing signals make it.
    vanishes(nodes) {
      const { of } = this, ends = this.among(nodes, this.squares) || this.among(nodes, this.gone.flatMap((x) => of.rates(x)));
      return (ends && this.bounded(of.rates(nodes))) || this.made(nodes);
    }
    check() {
      const shown = [];
      for (;;) {
        const found = this.wanted.filter((x) => !shown.includes(x) && this.follows(x.says, x.vector));
        const used = this.sources.filter(([premise, nodes]) => this.made(premise) && !this.made(nodes));
        for (const x of found) if (x.says === "goes to zero") this.vanish(x.vector);
        shown.push(...found);
        for (const [, nodes, text] of used) {
          this.vanish(nodes);
          if (text) this.signs.assumed.push(text);
        }
        if (!found.length && !used.length) return shown;
      }
    }
    follows(says, nodes) {
      if (says === "is bounded") return this.bounded(nodes);
      if (says === "is square-integrable") return this.among(nodes, this.squares);
      return says === "goes to zero" && this.vanishes(nodes);
    }
  }

  // What holds for any residual: all that is dissipated is in sum at most V at the start and the residual.
  function* withResidual(of, strict) {
    yield "V does not rise where the residual is zero";
    const squares = of.terms.filter((x) => x.role === "dissipated" && x.rule === "square"), weak = new Set(squares.filter((x) => !strict.has(x)).map((x) => x.name));
    for (const { name } of squares) if (!weak.has(name)) yield `${name} is ${of.samples ? "summable" : "integrable"} where the residual is`;
    const boxes = of.terms.filter((x) => of.samples && x.rule === "projected" && of.of([...x.lower, ...x.upper], ["constant"]));
    const inside = new Set(boxes.flatMap((x) => clipped(of.graph, x)));
    for (const { label } of of.symbols) if (of.moves.get(of.places.get(label))?.every((k) => inside.has(k))) yield `${label} is bounded`;
  }

  function proved(data) {
    const of = new Certificate(data), signs = new Signs(of), [error, points] = identity(of), strict = signs.check();
    const named = (items) => items.map((item) => `${item.signal} ${item.says}`);
    let shown = [];
    if (of.samples || of.terms.some((term) => term.role === "residual")) shown = [...new Set(withResidual(of, strict))];
    else {
      shown = named(new Conclusions(of, signs, strict).check());
    }
    const labels = (kind, more = () => true) => of.symbols.filter((item) => item.kind === kind && more(item)).map((item) => item.label).join(", ");
    const given = of.samples ? "" : labels("given"), still = labels("constant");
    const exact = (item) => of.inputs(item.label).every((k) => of.known.has(k) && String(of.known.get(k)[0]) === String(of.known.get(k)[1]));
    const some = of.samples ? "" : labels("constant", (item) => !exact(item));
    const stated = [still && `constant: ${still}`, given && `bounded: ${given}`, some && `conclusions are for almost all values of: ${some}`];
    return {
      status: "re-proved",
      statement: of.samples ? "V(next) - V" : "dV/dt",
      log2_error: Math.round(error),
      points,
      robot: of.robots.map(({ position, joints, torque }) => {
        const reads = [...of.graph.reads(torque)].map((k) => of.symbols[k].label).sort().join(", ");
        return `${position}: a chain of ${joints.length} rigid bodies, whose acceleration follows from a torque of ${reads}`;
      }),
      "only_at_exact_values_of": of.fixed.sort(),
      conclusions: shown,
      not_checked: named(of.conclusions).filter((text) => !shown.includes(text)),
      assumed: [...ASSUMED, ...stated.filter((x) => x), ...new Set(signs.assumed), ...of.assumed],
    };
  }

  // The result of the check of a parsed file; `status` is re-proved, refuted or refused, the latter two with a `reason`.
  function check(data) {
    try {
      return proved(data);
    } catch (fault) {
      if (fault instanceof Refuted) return { status: "refuted", reason: fault.message };
      return { status: "refused", reason: `${fault instanceof Refused ? "" : "no valid certificate: "}${fault.message}` };
    }
  }
  return { check };
})();

if (typeof module === "object" && typeof require === "function") {
  globalThis.crypto ??= require("crypto").webcrypto;
  const fs = require("fs");
  // At most 20 MB of a file, which may be a pipe or a device.
  const content = (path) => {
    const file = fs.openSync(path), bytes = Buffer.alloc(2e7);
    let size = 0;
    for (let more = 1; more && size < 2e7; size += more) more = fs.readSync(file, bytes, size, 2e7 - size);
    return bytes.subarray(0, size);
  };
  // The data of a file of UTF-8. No key occurs twice in one object: the text has as many keys as the data. All numbers are whole.
  const read = (bytes) => {
    if (!bytes.length) throw new Error("it is empty");
    if (bytes.length >= 2e7) throw new Error("it is too long");
    const text = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes);
    let count = -1;
    const data = JSON.parse(text, function (_, value) {
      if (!Array.isArray(this)) count++;
      return value;
    });
    const strings = /"[^"\\]*(?:\\.[^"\\]*)*"\s*:?/g;
    if ((text.match(strings) ?? []).filter((token) => token.endsWith(":")).length !== count) throw new Error("a key occurs twice in one object");
    if (/\d[.eE]/.test(text.replace(strings, ""))) throw new Error("a number that is not whole");
    return data;
  };
  module.exports = { ...globalThis.checker, read };
  if (require.main === module) {
    const paths = process.argv.slice(2).filter((x) => x !== "--json");
    let result = { status: "refused", reason: "usage: node check.js FILE [--json]" };
    try {
      if (paths.length === 1) result = globalThis.checker.check(read(content(paths[0])));
    } catch (fault) {
      result.reason = `cannot read the file: ${fault.message}`;
    }
    process.stdout.on("error", ({ code }) => { // a program such as head closes its pipe
      if (code !== "EPIPE") process.exitCode = 2;
    });
    const escaped = (x) => String(x).replace(/[^ -~]/g, (letter) => `\\u${letter.charCodeAt(0).toString(16).padStart(4, "0")}`);
    if (process.argv.includes("--json")) console.log(JSON.stringify(result, null, 1));
    else for (const [name, value] of Object.entries(result)) console.log(`${name.replaceAll("_", " ")}:${Array.isArray(value) ? value.map((x) => `\n  ${escaped(x)}`).join("") : ` ${escaped(value)}`}`);
    process.exitCode = { "re-proved": 0, refuted: 1, refused: 2 }[result.status];
  }
}
