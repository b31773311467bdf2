// A turnable view of meshes with values by colour: WebGL alone, data inside the page.
"use strict";
const VERTEX = `
attribute vec3 position, normal; attribute float value;
uniform mat4 view; uniform vec3 low, size; uniform mat3 turn;
varying vec3 n; varying float v;
void main() { n = turn * normal; v = value; gl_Position = view * vec4(low + position * size, 1.0); }`;
const FRAGMENT = `
precision mediump float;
varying vec3 n; varying float v;
uniform sampler2D colours; uniform float top; uniform bool clay;
void main() {
  vec3 m = normalize(n);
  float light = 0.35 + 0.65 * abs(dot(m, normalize(vec3(0.35, 0.45, 0.82))));
  vec3 base = clay ? vec3(0.80, 0.77, 0.74) : texture2D(colours, vec2(clamp(v / top, 0.0, 1.0), 0.5)).rgb;
  if (!clay && v > 0.999) base = vec3(0.59);
  gl_FragColor = vec4(base * (gl_FrontFacing ? light : 0.6 * light), 1.0);
}`;

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

// Little-endian 16- or 32-bit numbers.
const whole = (text, bits) => {
  const data = bytes(text).buffer;
  return bits === 16 ? new Uint16Array(data) : new Uint32Array(data);
};

// Area-weighted normals of the vertices, as signed bytes.
function normals(points, size, triangles) {
  const sum = new Float32Array(points.length);
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b, c] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
    const u = [0, 1, 2].map((k) => (points[b + k] - points[a + k]) * size[k]);
    const w = [0, 1, 2].map((k) => (points[c + k] - points[a + k]) * size[k]);
    for (let k = 0; k < 3; k++) {
      const [i, j] = [(k + 1) % 3, (k + 2) % 3];
      const n = u[i] * w[j] - u[j] * w[i];
      sum[a + k] += n; sum[b + k] += n; sum[c + k] += n;
    }
  }
  const out = new Int8Array(points.length);
  for (let i = 0; i < sum.length; i += 3) {
    const length = Math.hypot(sum[i], sum[i + 1], sum[i + 2]) || 1;
    for (let k = 0; k < 3; k++) out[i + k] = Math.round(127 * sum[i + k] / length);
  }
  return out;
}

function program(gl) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  return made;
}

class Viewer {
  constructor(figure) {
    this.figure = figure;
    this.data = JSON.parse(figure.querySelector("script").textContent);
    this.canvas = figure.querySelector("canvas");
    this.gl = this.canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
    if (!this.gl || !this.gl.getExtension("OES_element_index_uint")) {
      figure.classList.add("flat");
      return;
    }
    this.angles = [0.45, 0.08];
    this.zoom = 1;
    this.shown = [];
    this.start();
    this.controls();
    this.show();
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  start() {
    const { gl, data } = this;
    this.program = program(gl);
    gl.useProgram(this.program);
    gl.enable(gl.DEPTH_TEST);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    const colours = bytes(data.colours);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, colours.length / 3, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, colours);
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    const wide = (k) => {
      const ends = data.meshes.map((m) => [m.low[k], m.low[k] + m.size[k]]);
      return [Math.min(...ends.map((e) => e[0])), Math.max(...ends.map((e) => e[1]))];
    };
    const box = [0, 1, 2].map(wide);
    this.centre = box.map((e) => (e[0] + e[1]) / 2);
    this.radius = Math.hypot(...box.map((e) => e[1] - e[0])) / 2;
  }

  // The mesh on the card; made when it is first shown.
  mesh(k) {
    const { gl, data } = this;
    if (this.shown[k]) return this.shown[k];
    const from = data.meshes[k];
    const topology = data.topologies[from.topology];
    const [points, triangles] = [whole(from.positions, 16), whole(topology.triangles, topology.bits)];
    const buffer = (kind, of) => {
      const made = gl.createBuffer();
      gl.bindBuffer(kind, made);
      gl.bufferData(kind, of, gl.STATIC_DRAW);
      return made;
    };
    this.shown[k] = {
      positions: buffer(gl.ARRAY_BUFFER, points),
      normals: buffer(gl.ARRAY_BUFFER, normals(points, from.size, triangles)),
      triangles: buffer(gl.ELEMENT_ARRAY_BUFFER, triangles),
      count: triangles.length,
      type: topology.bits === 16 ? gl.UNSIGNED_SHORT : gl.UNSIGNED_INT,
      values: (from.values || []).map((of) => buffer(gl.ARRAY_BUFFER, bytes(of))),
    };
    return this.shown[k];
  }

  controls() {
    const { figure, canvas, data } = this;
    const of = (name) => figure.querySelector(`[name=${name}]`);
    [this.slider, this.choice, this.values, this.top] = ["mesh", "choice", "values", "top"].map(of);
    data.meshes.forEach((mesh, k) => this.choice.add(new Option(mesh.name, k)));
    data.quantities.forEach((name, k) => this.values.add(new Option(name, k)));
    this.values.add(new Option("shape alone", -1));
    this.slider.max = data.meshes.length - 1;
    this.choice.value = this.slider.value = 0;
    const coloured = data.quantities.length > 0;
    figure.querySelectorAll("[data-values]").forEach((part) => { part.hidden = !coloured; });
    this.slider.addEventListener("input", () => { this.choice.value = this.slider.value; this.show(); });
    this.choice.addEventListener("input", () => { this.slider.value = this.choice.value; this.show(); });
    this.values.addEventListener("input", () => this.show());
    this.top.addEventListener("input", () => this.show());
    canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); canvas.focus(); });
    canvas.addEventListener("pointermove", (e) => {
      if (canvas.hasPointerCapture(e.pointerId)) this.turn(e.movementX / 120, e.movementY / 120);
    });
    canvas.addEventListener("wheel", (e) => {
      if (document.activeElement !== canvas) return;
      e.preventDefault();
      this.scale(Math.exp(-e.deltaY / 800));
    }, { passive: false });
    const keys = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
    canvas.addEventListener("keydown", (e) => {
      if (keys[e.key]) this.turn(...keys[e.key]);
      else if (e.key === "+" || e.key === "-") this.scale(e.key === "+" ? 1.1 : 1 / 1.1);
      else return;
      e.preventDefault();
    });
  }

  turn(yaw, pitch) {
    this.angles[0] += yaw;
    this.angles[1] = Math.max(-1.5, Math.min(1.5, this.angles[1] + pitch));
    this.draw();
  }

  scale(factor) {
    this.zoom = Math.max(0.5, Math.min(12, this.zoom * factor));
    this.draw();
  }

  // Words and colour bar follow what is chosen.
  show() {
    const { data, figure } = this;
    const mesh = data.meshes[this.slider.value];
    const high = data.high * this.top.value / 100;
    figure.querySelector("output").textContent = mesh.said;
    figure.querySelector(".bar-high").textContent = `≥ ${Number(high.toPrecision(3))} ${data.unit}`;
    this.draw();
  }

  draw() {
    const { gl, canvas, data } = this;
    const dense = Math.min(window.devicePixelRatio || 1, 2);
    [canvas.width, canvas.height] = [canvas.clientWidth * dense, canvas.clientHeight * dense].map(Math.round);
    if (!canvas.width || !canvas.height) return;
    const [k, quantity] = [Number(this.slider.value), Number(this.values.value)];
    const [mesh, from] = [this.mesh(k), data.meshes[k]];
    const [cy, sy, cp, sp] = [Math.cos(this.angles[0]), Math.sin(this.angles[0]), Math.cos(this.angles[1]), Math.sin(this.angles[1])];
    // Rows of the rotation: yaw about the vertical, then pitch.
    const r = [[cy, 0, sy], [sp * sy, cp, -sp * cy], [-cp * sy, sp, cp * cy]];
    const across = canvas.width / canvas.height;
    const s = this.zoom / (0.82 * this.radius);
    const [sx, sv] = across > 1 ? [s / across, s] : [s, s * across];
    const scaled = [r[0].map((v) => v * sx), r[1].map((v) => v * sv), r[2].map((v) => -v / (2 * this.radius))];
    const shift = scaled.map((row) => -row.reduce((sum, v, i) => sum + v * this.centre[i], 0));
    const column = (i) => [scaled[0][i], scaled[1][i], scaled[2][i], 0];
    const place = (name) => gl.getUniformLocation(this.program, name);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(place("view"), false, [...column(0), ...column(1), ...column(2), ...shift, 1]);
    gl.uniformMatrix3fv(place("turn"), false, [0, 1, 2].flatMap((i) => [r[0][i], r[1][i], r[2][i]]));
    gl.uniform3fv(place("low"), from.low);
    gl.uniform3fv(place("size"), from.size);
    const values = mesh.values[quantity];
    gl.uniform1i(place("clay"), values ? 0 : 1);
    // Bytes go to 254 for the greatest value; 255 is no value.
    gl.uniform1f(place("top"), (254 / 255) * this.top.value / 100);
    const feed = (name, buffer, count, type, normalized) => {
      const at = gl.getAttribLocation(this.program, name);
      if (at < 0) return;
      if (!buffer) { gl.disableVertexAttribArray(at); return; }
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, count, type, normalized, 0, 0);
    };
    feed("position", mesh.positions, 3, gl.UNSIGNED_SHORT, true);
    feed("normal", mesh.normals, 3, gl.BYTE, true);
    feed("value", values, 1, gl.UNSIGNED_BYTE, true);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.triangles);
    gl.drawElements(gl.TRIANGLES, mesh.count, mesh.type, 0);
  }
}

// All at once: a page has few, and what waits to come into sight is missing in print and in pictures of the page.
document.querySelectorAll("figure.view3d").forEach((figure) => new Viewer(figure));
