// 3D view of the robot by WebGL2; without WebGL2, its links as lines on a 2D canvas with the same camera.

const SOLID = [`#version 300 es
in vec3 place, normal; uniform mat4 model, camera; out vec3 world, facing;
void main() { vec4 w = model * vec4(place, 1.); world = w.xyz; facing = mat3(model) * normal; gl_Position = camera * w; }`,
`#version 300 es
precision highp float; in vec3 world, facing; uniform vec3 eye, colour; out vec4 shade;
void main() {
  vec3 n = normalize(facing), view = normalize(eye - world), light = normalize(view + vec3(.2, .3, .9));
  if (dot(n, view) < 0.) n = -n;
  float shine = pow(max(dot(n, normalize(light + view)), 0.), 40.) * .18;
  shade = vec4(colour * (.42 + .58 * max(dot(n, light), 0.)) + shine, 1.);
}`];
// Wide lines: each segment is a rectangle that faces the camera, since lines of WebGL are one pixel wide.
const LINES = [`#version 300 es
in vec3 a, b; uniform mat4 camera; uniform vec2 size; uniform float width, front;
void main() {
  vec4 p = camera * vec4(a, 1.), q = camera * vec4(b, 1.), c = gl_VertexID < 2 ? p : q;
  if (p.w < .01 || q.w < .01) { gl_Position = vec4(2., 2., 2., 1.); return; }
  vec2 along = (q.xy / q.w - p.xy / p.w) * size; along /= max(length(along), 1e-9);
  float side = gl_VertexID % 2 == 0 ? 1. : -1., end = gl_VertexID < 2 ? -1. : 1.;
  c.xy += (vec2(-along.y, along.x) * side + along * end * .5) * width / size * c.w; c.z -= front * c.w; gl_Position = c;
}`,
`#version 300 es
precision highp float; uniform vec4 ink; out vec4 shade; void main() { shade = ink; }`];

class Scene {
  // `box`: smallest and largest coordinates of the robot over the run.
  constructor(canvas, robot, box, changed) {
    Object.assign(this, { canvas, robot, changed });
    const spans = box.high.map((high, k) => high - box.low[k]), most = Math.max(...spans) || 1;
    this.size = most;
    this.normal = spans.findIndex((span) => span < 1e-6 * most); // axis normal to the plane of a planar motion
    const flat = this.normal >= 0;
    if (!flat) this.normal = 2;
    this.home = {
      turn: flat && this.normal === 0 ? 0 : flat ? -Math.PI / 2 : -0.75, lift: !flat ? 0.4 : this.normal === 2 ? 1.4 : 0.1,
      far: (flat ? 2.4 : 1.8) * Math.hypot(...spans), target: box.high.map((high, k) => (high + box.low[k]) / 2),
    };
    this.camera = { ...this.home };
    this.kept = {};
    this.gl = canvas.getContext("webgl2", { antialias: true, alpha: true });
    try {
      if (this.gl) this.prepare();
      this.watch();
    } catch { // the graphics context was lost before the first frame
      this.fallBack();
    }
  }

  // Event handlers of the canvas; `fallBack` replaces the canvas and calls this again.
  watch() {
    this.controls();
    this.canvas.addEventListener("webglcontextlost", () => this.fallBack());
    new ResizeObserver(() => this.changed()).observe(this.canvas);
  }

  // Continues on a 2D canvas. A browser drops a graphics context on standby, or that of the oldest of many pages. A canvas
  // that had a WebGL context cannot get a 2D context, so a new canvas replaces it.
  fallBack() {
    const old = this.canvas, focused = document.activeElement === old;
    this.gl = null;
    this.canvas = old.cloneNode();
    old.replaceWith(this.canvas);
    if (focused) this.canvas.focus();
    this.watch();
    this.changed();
  }

  prepare() {
    const { gl } = this;
    this.solid = program(gl, SOLID, ["place", "normal"]);
    this.lines = program(gl, LINES, ["a", "b"]);
    this.buffers = {};
    this.ball = shape(gl, ...sphere());
    this.tube = shape(gl, ...cylinder());
    this.meshes = this.robot.meshes.map((mesh) => ({ joint: mesh.joint, shape: shape(gl, ...creased(mesh)) })); // decoded by `decodedMesh`
    this.line("grid", this.grid(), true);
  }

  // Segments of a square grid under the robot, or behind a robot with planar motion.
  grid() {
    const step = [0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10].find((step) => step > this.size / 8) ?? this.size / 8;
    const count = Math.ceil((1.5 * this.size) / step), found = [], [u, v] = [0, 1, 2].filter((k) => k !== this.normal);
    for (let k = -count; k <= count; k++)
      for (const [first, second] of [[u, v], [v, u]])
        for (let j = -count; j < count; j++)
          for (const end of [j, j + 1]) {
            const point = [0, 0, 0];
            [point[first], point[second]] = [k * step, end * step];
            found.push(...point);
          }
    return Float32Array.from(found);
  }

  // Stores the points of a polyline; `pieces`: pairs of points are separate segments.
  line(name, points, pieces = false) {
    const { gl } = this;
    this.kept[name] = { points, pieces };
    if (!gl) return;
    const entry = (this.buffers[name] ??= { array: gl.createVertexArray(), buffer: gl.createBuffer() });
    gl.bindVertexArray(entry.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, entry.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.DYNAMIC_DRAW);
    for (const place of [0, 1]) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribDivisor(place, 1);
    }
    entry.stride = pieces ? 24 : 12;
    entry.count = pieces ? points.length / 6 : Math.max(0, points.length / 3 - 1);
  }

  controls() {
    const { canvas, camera } = this, pointers = new Map();
    let spread = 0;
    const turned = (across, up) => {
      camera.turn -= across;
      camera.lift = Math.max(-1.5, Math.min(1.5, camera.lift + up));
      this.changed();
    };
    this.zoom = (factor) => {
      camera.far = Math.max(this.size * 0.8, Math.min(this.size * 12, camera.far * factor));
      this.changed();
    };
    this.back = () => { Object.assign(camera, this.home); this.changed(); };
    canvas.onpointerdown = (event) => { pointers.set(event.pointerId, [event.clientX, event.clientY]); canvas.setPointerCapture(event.pointerId); spread = 0; };
    canvas.onpointerup = canvas.onpointercancel = (event) => { pointers.delete(event.pointerId); spread = 0; };
    canvas.onpointermove = (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      if (pointers.size === 1) return turned((event.clientX - before[0]) * 0.008, (event.clientY - before[1]) * 0.008);
      const [first, second] = pointers.values(), now = Math.hypot(first[0] - second[0], first[1] - second[1]);
      if (spread && now) this.zoom(spread / now);
      spread = now;
    };
    // without focus or Ctrl key, the wheel scrolls the page
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== canvas) return;
      event.preventDefault();
      this.zoom(Math.exp(event.deltaY * 0.0012));
    }, { passive: false });
    canvas.onkeydown = (event) => {
      const act = {
        ArrowLeft: () => turned(-0.1, 0), ArrowRight: () => turned(0.1, 0), ArrowUp: () => turned(0, 0.1),
        ArrowDown: () => turned(0, -0.1), "+": () => this.zoom(0.9), "-": () => this.zoom(1.1), Home: this.back,
      }[event.key];
      if (!act) return;
      event.preventDefault();
      act();
    };
  }

  eye() {
    const { turn, lift, far, target } = this.camera;
    return [target[0] + far * Math.cos(lift) * Math.cos(turn), target[1] + far * Math.cos(lift) * Math.sin(turn), target[2] + far * Math.sin(lift)];
  }

  // `frames`: rotation and position of each joint (12 numbers) and position of the tool (3); `aim`: desired position of
  // the tool, or null; `traces`: polylines from segment `from` to `past`, each with a ball at its end; `inks`: colours.
  draw({ frames, aim, traces, inks }) {
    const { canvas, gl } = this, ratio = Math.min(devicePixelRatio || 1, 1.5);
    const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
    if (!wide || !high) return;
    const [w, h] = [Math.round(wide * ratio), Math.round(high * ratio)];
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    const eye = this.eye(), seen = looking(eye, this.camera.target, wide / high, this.size);
    const points = [[0, 0, 0]], joints = this.robot.joints;
    for (let k = 0; k < joints; k++) points.push(Array.from(frames.subarray(12 * k + 9, 12 * k + 12)));
    points.push(Array.from(frames.subarray(12 * joints, 12 * joints + 3)));
    if (!gl) return this.flatly({ points, aim, traces, inks, seen, ratio });
    gl.viewport(0, 0, w, h);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this.solid.program);
    gl.uniformMatrix4fv(this.solid.of("camera"), false, seen);
    gl.uniform3fv(this.solid.of("eye"), eye);
    const solid = (what, model, ink) => {
      gl.uniformMatrix4fv(this.solid.of("model"), false, model);
      gl.uniform3fv(this.solid.of("colour"), ink.slice(0, 3));
      gl.bindVertexArray(what.array);
      gl.drawArrays(gl.TRIANGLES, 0, what.count);
    };
    for (const { joint, shape } of this.meshes) solid(shape, placed(frames, joint), inks.body);
    const thick = this.size * 0.035;
    if (!this.meshes.length)
      for (let k = 0; k + 1 < points.length; k++) {
        const stretch = between(points[k], points[k + 1], thick * (1 - 0.3 * (k / points.length)));
        if (stretch) solid(this.tube, stretch, inks.body);
        solid(this.ball, ball(points[k + 1], thick * (k + 2 < points.length ? 1.5 : 0.9)), inks.joint);
      }
    for (const { end, ink } of traces) solid(this.ball, ball(end, thick * 0.5), ink);
    if (aim) solid(this.ball, ball(aim, thick * 0.42), inks.path);
    gl.useProgram(this.lines.program);
    gl.uniformMatrix4fv(this.lines.of("camera"), false, seen);
    gl.uniform2f(this.lines.of("size"), wide, high);
    const drawn = (name, ink, width, front, { from = 0, past = Infinity } = {}) => {
      const entry = this.buffers[name], last = Math.min(entry?.count ?? 0, past);
      if (last <= from) return;
      gl.uniform4fv(this.lines.of("ink"), ink);
      gl.uniform1f(this.lines.of("width"), width);
      gl.uniform1f(this.lines.of("front"), front);
      gl.bindVertexArray(entry.array);
      gl.bindBuffer(gl.ARRAY_BUFFER, entry.buffer);
      for (const place of [0, 1]) gl.vertexAttribPointer(place, 3, gl.FLOAT, false, entry.stride, 12 * place + from * entry.stride);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, last - from);
    };
    drawn("grid", inks.grid, 1, 0);
    drawn("path", inks.path, 2, 2e-4);
    for (const { name, ink, ...part } of traces) drawn(name, ink, 3, 4e-4, part);
  }

  // The same on a 2D canvas: links as lines, in order of decreasing distance.
  flatly({ points, aim, traces, inks, seen, ratio }) {
    const { canvas } = this, g = (this.flat ??= canvas.getContext("2d"));
    if (!g) return;
    if (!this.kept.grid) this.line("grid", this.grid(), true);
    const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.clearRect(0, 0, wide, high);
    g.lineCap = "round";
    const at = ([x, y, z]) => {
      const [a, b, c] = [0, 1, 3].map((i) => seen[i] * x + seen[4 + i] * y + seen[8 + i] * z + seen[12 + i]);
      return [((a / c + 1) * wide) / 2, ((1 - b / c) * high) / 2, c];
    };
    const css = ([red, green, blue, alpha = 1]) => `rgba(${[red, green, blue].map((part) => Math.round(part * 255))},${alpha})`;
    const polyline = (name, ink, width, { from = 0, past = Infinity } = {}) => {
      const { points = [], pieces } = this.kept[name] ?? {};
      g.strokeStyle = css(ink);
      g.lineWidth = width;
      g.beginPath();
      for (let k = from; 3 * k < points.length && k <= past; k++) {
        const [x, y] = at(points.subarray(3 * k, 3 * k + 3));
        if (pieces ? k % 2 : k > from) g.lineTo(x, y); else g.moveTo(x, y);
      }
      g.stroke();
    };
    polyline("grid", inks.grid, 1);
    polyline("path", inks.path, 2);
    const thick = this.size * 0.035, parts = points.slice(1).map((to, k) => [at(points[k]), at(to), k]);
    for (const [from, to] of parts.sort((p, q) => q[0][2] + q[1][2] - p[0][2] - p[1][2])) {
      g.strokeStyle = css(inks.body);
      g.lineWidth = (1.6 * thick * high) / to[2];
      g.beginPath();
      g.moveTo(from[0], from[1]);
      g.lineTo(to[0], to[1]);
      g.stroke();
      disc(g, to, (1.4 * thick * high) / to[2], css(inks.joint));
    }
    for (const { name, ink, ...part } of traces) polyline(name, ink, 2.5, part);
    if (aim) disc(g, at(aim), 4, css(inks.path));
    for (const { end, ink } of traces) disc(g, at(end), 5, css(ink));
  }
}

function disc(g, [x, y], radius, ink) {
  g.fillStyle = ink;
  g.beginPath();
  g.arc(x, y, radius, 0, 7);
  g.fill();
}

function program(gl, sources, attributes) {
  const made = gl.createProgram();
  [gl.VERTEX_SHADER, gl.FRAGMENT_SHADER].forEach((kind, k) => {
    const part = gl.createShader(kind);
    gl.shaderSource(part, sources[k]);
    gl.compileShader(part);
    gl.attachShader(made, part);
  });
  attributes.forEach((name, place) => gl.bindAttribLocation(made, place, name));
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  const places = {};
  return { program: made, of: (name) => (places[name] ??= gl.getUniformLocation(made, name)) };
}

// Vertex array of triangles: position and normal of each corner.
function shape(gl, places, normals) {
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  [places, normals].forEach((numbers, place) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
  });
  return { array, count: places.length / 3 };
}

// Triangles of a mesh. The normal of a corner is the mean over the adjacent faces within 40 degrees, so that round parts
// are smooth and edges sharp.
function creased({ low, high, grid, of }) {
  const count = of.length / 3, point = (k) => [0, 1, 2].map((i) => low[i] + ((high[i] - low[i]) * grid[3 * k + i]) / 4095);
  const points = Array.from({ length: grid.length / 3 }, (_, k) => point(k)), meeting = points.map(() => []);
  const flats = Array.from({ length: count }, (_, f) => {
    for (let i = 0; i < 3; i++) meeting[of[3 * f + i]].push(f);
    const [a, b, c] = [0, 1, 2].map((i) => points[of[3 * f + i]]);
    const n = cross(minus(b, a), minus(c, a)), size = Math.hypot(...n) || 1;
    return { n: n.map((part) => part / size), size };
  });
  const places = new Float32Array(9 * count), normals = new Float32Array(9 * count);
  for (let at = 0; at < 3 * count; at++) {
    const own = flats[Math.floor(at / 3)].n, sum = [0, 0, 0];
    for (const f of meeting[of[at]]) {
      const { n, size } = flats[f];
      if (dot(n, own) > 0.77) for (let i = 0; i < 3; i++) sum[i] += n[i] * size;
    }
    places.set(points[of[at]], 3 * at);
    normals.set(unit(sum), 3 * at);
  }
  return [places, normals];
}

// Decodes a mesh: grid coordinates of its corners and corner indices of its faces, from columns of differences.
async function decodedMesh(mesh) {
  const bytes = new Uint8Array(await unpacked(mesh.packed)), { corners, faces } = mesh;
  let at = 0;
  const column = (size) => {
    const found = Int16Array.from({ length: size }, (_, k) => bytes[at + k] | (bytes[at + size + k] << 8));
    at += 2 * size;
    return found;
  };
  const summed = (steps) => { for (let k = 1; k < steps.length; k++) steps[k] += steps[k - 1]; return steps; };
  const [x, y, z] = [0, 0, 0].map(() => summed(column(corners)));
  const first = summed(column(faces)), [second, third] = [column(faces), column(faces)];
  const grid = Array.from(x).flatMap((_, k) => [x[k], y[k], z[k]]);
  return { ...mesh, grid, of: Array.from(first).flatMap((a, k) => [a, a + second[k], a + third[k]]) };
}

// Unit sphere over two angles, and unit cylinder over an angle and z in [0, 1], as quadrilaterals.
function sphere() {
  return woven(12, (u, v) => {
    const [a, b] = [2 * Math.PI * u, Math.PI * v], n = [Math.sin(b) * Math.cos(a), Math.sin(b) * Math.sin(a), -Math.cos(b)];
    return [n, n];
  });
}

function cylinder() {
  return woven(1, (u, v) => {
    const n = [Math.cos(2 * Math.PI * u), Math.sin(2 * Math.PI * u), 0];
    return [[n[0], n[1], v], n];
  });
}

function woven(rows, at) {
  const places = [], normals = [], round = 24;
  for (let i = 0; i < round; i++)
    for (let j = 0; j < rows; j++)
      for (const [du, dv] of [[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]]) {
        const [place, normal] = at((i + du) / round, (j + dv) / rows);
        places.push(...place);
        normals.push(...normal);
      }
  return [Float32Array.from(places), Float32Array.from(normals)];
}

// 4 x 4 matrices, in column-major order.
function placed(frames, joint) {
  if (joint < 0) return [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  const f = frames.subarray(12 * joint, 12 * joint + 12);
  return [f[0], f[1], f[2], 0, f[3], f[4], f[5], 0, f[6], f[7], f[8], 0, f[9], f[10], f[11], 1];
}

function ball([x, y, z], r) {
  return [r, 0, 0, 0, 0, r, 0, 0, 0, 0, r, 0, x, y, z, 1];
}

function between(from, to, r) {
  const axis = minus(to, from), length = Math.hypot(...axis);
  if (length < 1e-6) return null;
  const w = axis.map((part) => part / length), u = unit(cross(Math.abs(w[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0], w)), v = cross(w, u);
  return [...u.map((part) => part * r), 0, ...v.map((part) => part * r), 0, ...axis, 0, ...from, 1];
}

function looking(eye, target, aspect, size) {
  const back = unit(minus(eye, target)), right = unit(cross([0, 0, 1], back)), up = cross(back, right);
  const near = 0.05 * size, far = 40 * size, tall = 3.1 * Math.min(1, 0.9 * aspect);
  const rows = [
    [...right, -dot(right, eye)].map((part) => (part * tall) / aspect),
    [...up, -dot(up, eye)].map((part) => part * tall),
    [...back, -dot(back, eye)].map((part) => (part * (far + near)) / (near - far)),
    [...back, -dot(back, eye)].map((part) => -part),
  ];
  rows[2][3] += (2 * far * near) / (near - far);
  return Float32Array.from([0, 1, 2, 3].flatMap((column) => rows.map((row) => row[column])));
}

const minus = (a, b) => a.map((part, k) => part - b[k]);
const dot = (a, b) => a.reduce((sum, part, k) => sum + part * b[k], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => { const size = Math.hypot(...a) || 1; return a.map((part) => part / size); };
