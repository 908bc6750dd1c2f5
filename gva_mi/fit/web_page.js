"use strict";
// Draws the avatar that gva_mi/fit/web_page.py packed into this page, and serves its controls.
//
// For every picture the CPU takes the joints' transforms between two frames, adds blend shapes to
// the means at rest, and sorts the Gaussians by depth. The GPU skins each Gaussian
// (gva_mi/avatar/skin_gaussians.py, eq. 1-6) and projects it to an ellipse
// (gva_mi/splat/kernels/ellipse.py, eq. 4-7), drawn far to near; shaders are in web_page.html.
// Cameras have OpenCV's axes: x right, y down, z forward. Lengths are metres, angles radians.

const JOINTS = 55;
const TEXELS = 1024; // width of every texture
const NEAR = 0.01; // metres, as gva_mi.splat.SplatOptions
const DEPTHS = 1 << 16; // levels of depth that are told apart
const CLAY = [0.72, 0.7, 0.68]; // of the mesh
const find = (id) => document.getElementById(id);

// ---- the data of the page -----------------------------------------------------------------------

async function readAvatar(text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const bytes = await new Response(stream).arrayBuffer();
  const length = new DataView(bytes).getUint32(0, true);
  const avatar = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  const kinds = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, i2: Int16Array, f4: Float32Array };
  for (const { name, kind, at, count, step } of avatar.arrays) {
    const stored = new kinds[kind](bytes, 4 + length + at, count);
    avatar[name] = step ? Float32Array.from(stored, (x) => x * step) : stored;
  }
  return avatar;
}

function starts(counts) { // where each list begins, and where the last one ends
  const begin = new Uint32Array(counts.length + 1);
  counts.forEach((count, n) => { begin[n + 1] = begin[n] + count; });
  return begin;
}

// ---- points that follow the joints --------------------------------------------------------------

class Points { // points at rest that follow joints and blend shapes; ``kind``: which arrays
  constructor(avatar, kind) {
    const of = (name) => avatar[kind + name];
    this.means = of("Means");
    this.count = this.means.length / 3;
    this.pairs = starts(of("PairCounts"));
    [this.joints, this.weights, this.slopes] = [of("PairJoints"), of("PairWeights"), of("PairSlopes")];
    this.shapes = starts(of("ShapeCounts"));
    [this.numbers, this.metres] = [of("ShapeNumbers"), of("ShapeMetres")];
    this.rest = new Float32Array(4 * (this.count + 1)); // mean, and where its pairs begin
    this.pairs.forEach((begin, n) => { this.rest[4 * n + 3] = begin; });
  }
  bend(coefficients) {
    for (let n = 0; n < this.count; ++n) {
      for (let i = 0; i < 3; ++i) {
        let x = this.means[3 * n + i];
        for (let k = this.shapes[n]; k < this.shapes[n + 1]; ++k) {
          x += coefficients[this.numbers[k]] * this.metres[3 * k + i];
        }
        this.rest[4 * n + i] = x;
      }
    }
  }
  blend(rows, offset, width, out) { // out_n = sum of W_np (row ``offset`` of joint p · mean)
    for (let n = 0; n < this.count; ++n) {
      const [x, y, z] = [this.rest[4 * n], this.rest[4 * n + 1], this.rest[4 * n + 2]];
      let sum = 0;
      for (let k = this.pairs[n]; k < this.pairs[n + 1]; ++k) {
        const r = width * this.joints[k] + offset;
        sum += this.weights[k] * (rows[r] * x + rows[r + 1] * y + rows[r + 2] * z + rows[r + 3]);
      }
      out[n] = sum;
    }
  }
}

function farToNear(depths, order) { // a counting sort
  let low = Infinity, high = -Infinity;
  for (const z of depths) { if (z < low) low = z; if (z > high) high = z; }
  const levels = Uint16Array.from(depths, (z) => (DEPTHS - 1) * (high - z) / (high - low || 1));
  const begin = new Uint32Array(DEPTHS + 1);
  for (const level of levels) begin[level + 1]++;
  for (let k = 0; k < DEPTHS; ++k) begin[k + 1] += begin[k];
  levels.forEach((level, n) => { order[begin[level]++] = n; });
}

// ---- the camera ---------------------------------------------------------------------------------

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((x) => x / Math.hypot(...a));
const plus = (a, s, b) => a.map((x, i) => x + s * b[i]);

class Orbit { // as gva_mi.fit.renders.shots: around the middle of a motion, whole in the picture
  constructor(around, turn, elevation) {
    Object.assign(this, { around, turn, elevation, zoom: 1, target: around.centre });
  }
  see(width, height, constants) {
    const { up, front, radius } = this.around;
    const focal = constants.focalRatio * Math.max(width, height);
    const fits = Math.max(this.around.height / height, 2 * radius / width) * focal;
    const away = (radius + constants.roomAround * fits) / this.zoom;
    const level = plus(front.map((x) => x * Math.cos(this.turn)), Math.sin(this.turn), cross(up, front));
    const back = plus(level.map((x) => x * Math.cos(this.elevation)), Math.sin(this.elevation), up);
    const eye = plus(this.target, away, back), z = unit(back.map((x) => -x));
    const x = unit(cross(z, up)), y = cross(z, x);
    const view = [0, 1, 2].flatMap((i) => [x[i], y[i], z[i], 0]);
    return { view: [...view, -dot(x, eye), -dot(y, eye), -dot(z, eye), 1], rows: { x, y, z }, eye,
      focal, away, size: [width, height] };
  }
}

// ---- drawing ------------------------------------------------------------------------------------

class Painter {
  constructor(canvas, avatar) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false });
    if (!gl) throw new Error("this browser does not offer WebGL 2, which the avatar is drawn with");
    Object.assign(this, { gl, avatar, gaussians: new Points(avatar, "splat") });
    if (avatar.faces) this.surface = new Points(avatar, "mesh");
    this.splats = this.program("splat");
    this.mesh = this.program("mesh");
    const G = this.gaussians, N = G.count, shapes = new Float32Array(8 * N);
    for (let n = 0; n < N; ++n) {
      const scales = avatar.logScales.subarray(3 * n, 3 * n + 3).map(Math.exp);
      const quat = unit([...avatar.quats.subarray(4 * n, 4 * n + 4)]);
      shapes.set([...quat, ...scales, avatar.opacities[n]], 8 * n);
    }
    const pairs = new Float32Array(4 * G.weights.length);
    G.weights.forEach((w, k) => pairs.set([w, ...G.slopes.subarray(3 * k, 3 * k + 3)], 4 * k));
    const floats = [gl.RGBA32F, gl.RGBA, 4], three = [gl.RGB32F, gl.RGB, 3];
    const bytes = [gl.R8UI, gl.RED_INTEGER, 1];
    this.names = ["means", "shapes", "colors", "pairs", "joints", "followed"];
    const contents = [[G.rest, floats], [shapes, floats], [avatar.colors, three], [pairs, floats],
      [new Float32Array(12 * JOINTS), floats], [G.joints, bytes]];
    contents.forEach(([data, form], k) => this.texture(k, data, form));
    this.depths = new Float32Array(N);
    this.order = new Uint32Array(N);
    this.splatVertices = gl.createVertexArray();
    gl.bindVertexArray(this.splatVertices);
    this.orderBuffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.orderBuffer);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    if (!this.surface) return;
    this.meshVertices = gl.createVertexArray();
    gl.bindVertexArray(this.meshVertices);
    this.placeBuffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.placeBuffer);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, avatar.faces, gl.STATIC_DRAW);
  }

  program(name) { // of the shaders in the page
    const gl = this.gl, program = gl.createProgram();
    for (const part of ["vertex", "fragment"]) {
      const shader = gl.createShader(part === "vertex" ? gl.VERTEX_SHADER : gl.FRAGMENT_SHADER);
      gl.shaderSource(shader, find(`${name}-${part}`).textContent.trim());
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
      throw new Error(`the graphics driver refuses a program (${logs.join(" ")})`);
    }
    return program;
  }

  texture(number, data, [inner, format, channels]) { // rows of TEXELS, the last one padded
    const gl = this.gl, rows = Math.ceil(data.length / channels / TEXELS);
    const padded = new data.constructor(channels * TEXELS * rows);
    padded.set(data);
    gl.activeTexture(gl.TEXTURE0 + number);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, inner, TEXELS, rows, 0, format,
      data instanceof Uint8Array ? gl.UNSIGNED_BYTE : gl.FLOAT, padded);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    }
  }

  update(number, data) { // RGBA floats
    const gl = this.gl, texels = data.length / 4, whole = Math.floor(texels / TEXELS);
    gl.activeTexture(gl.TEXTURE0 + number);
    const part = (row, width, height) => gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, row, width, height,
      gl.RGBA, gl.FLOAT, data, 4 * row * TEXELS);
    if (whole) part(0, TEXELS, whole);
    if (texels > whole * TEXELS) part(whole, texels - whole * TEXELS, 1);
  }

  pose(motion, time) { // a time in frames; between two of them all numbers are interpolated
    const first = Math.floor(time), next = Math.min(first + 1, motion.frames - 1);
    const between = (values) => {
      const width = values.length / motion.frames, [a, b] = [first, next].map((k) => k * width);
      return Float32Array.from({ length: width }, (_, i) => values[a + i]
        + (time - first) * (values[b + i] - values[a + i]));
    };
    this.T = between(this.avatar[motion.arrays + "Transforms"]);
    this.coefficients = between(this.avatar[motion.arrays + "Coefficients"]);
    this.gaussians.bend(this.coefficients);
    this.update(0, this.gaussians.rest);
    this.update(4, this.T);
  }

  draw(camera, asMesh) {
    const gl = this.gl, [width, height] = camera.size;
    gl.viewport(0, 0, width, height);
    gl.clearColor(1, 1, 1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (asMesh) this.drawMesh(camera); else this.drawSplats(camera);
  }

  finished() { // the time at which the GPU has drawn all
    const gl = this.gl;
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    return performance.now();
  }

  drawSplats(camera) {
    const gl = this.gl, { z } = camera.rows, T = this.T, rows = new Float32Array(4 * JOINTS);
    for (let k = 0; k < rows.length; ++k) {
      const at = 12 * (k >> 2) + (k & 3);
      rows[k] = z[0] * T[at] + z[1] * T[at + 4] + z[2] * T[at + 8];
    }
    this.gaussians.blend(rows, 0, 4, this.depths);
    farToNear(this.depths, this.order);
    gl.useProgram(this.splats);
    gl.bindVertexArray(this.splatVertices);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.orderBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, this.order, gl.DYNAMIC_DRAW);
    const place = (name) => gl.getUniformLocation(this.splats, name);
    this.names.forEach((name, k) => gl.uniform1i(place(name), k));
    this.show(camera, place);
    gl.uniform2f(place("blurMin"), this.avatar.blur, this.avatar.alphaMin);
    gl.uniform1f(place("maxStretch"), this.avatar.maxStretch);
    gl.uniform3fv(place("light"), this.avatar.light || [0, 0, 0]);
    gl.uniform1i(place("lit"), this.avatar.light ? 1 : 0);
    gl.uniform3fv(place("eye"), camera.eye);
    gl.uniform1i(place("bands"), this.avatar.bands);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.gaussians.count);
  }

  drawMesh(camera) {
    const gl = this.gl, count = this.surface.count, places = new Float32Array(3 * count);
    this.surface.bend(this.coefficients);
    const column = new Float32Array(count);
    for (let i = 0; i < 3; ++i) {
      this.surface.blend(this.T, 4 * i, 12, column);
      column.forEach((x, n) => { places[3 * n + i] = x; });
    }
    gl.useProgram(this.mesh);
    gl.bindVertexArray(this.meshVertices);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.placeBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, places, gl.DYNAMIC_DRAW);
    const place = (name) => gl.getUniformLocation(this.mesh, name);
    this.show(camera, place);
    gl.uniform3fv(place("clay"), CLAY);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.drawElements(gl.TRIANGLES, this.avatar.faces.length, gl.UNSIGNED_INT, 0);
  }

  show(camera, place) { // the uniforms of a camera
    this.gl.uniformMatrix4fv(place("view"), false, camera.view);
    this.gl.uniform2fv(place("size"), camera.size);
    this.gl.uniform1f(place("focal"), camera.focal);
  }

  bones(context, camera) { // the skeleton, over the picture
    const { x, y, z } = camera.rows, [width, height] = camera.size, J = this.avatar.joints;
    const seen = Array.from({ length: JOINTS }, (_, j) => {
      const row = (i) => [...this.T.subarray(12 * j + 4 * i, 12 * j + 4 * i + 4)];
      const place = [0, 1, 2].map((i) => row(i)[3] + dot(row(i), J.subarray(3 * j, 3 * j + 3)));
      const p = plus(place, -1, camera.eye), depth = dot(p, z);
      const at = (axis, middle) => camera.focal * dot(p, axis) / depth + middle / 2;
      return depth > NEAR ? [at(x, width), at(y, height)] : null;
    });
    context.lineWidth = Math.max(1.5, Math.min(width, height) / 300);
    context.strokeStyle = context.fillStyle = "#e4572e";
    seen.forEach((point, j) => {
      const above = seen[this.avatar.parents[j]];
      if (!point) return;
      context.beginPath();
      context.arc(...point, context.lineWidth, 0, 2 * Math.PI);
      context.fill();
      if (!above) return;
      context.beginPath();
      context.moveTo(...above);
      context.lineTo(...point);
      context.stroke();
    });
  }
}

// ---- controls -----------------------------------------------------------------------------------

const TURN = 0.1, ZOOM = 1.1; // of a key or a notch of the wheel: radians, a factor
const TURN_PER_PIXEL = 0.008; // radians, of a finger or a mouse
const SHARPEST = 2; // pixels for a CSS pixel; chosen: finer ones cost time and look the same

class Player {
  constructor(avatar) {
    this.avatar = avatar;
    this.canvas = find("view");
    this.painter = new Painter(this.canvas, avatar);
    avatar.motions.forEach(({ name }) => find("motion").add(new Option(name)));
    const wanted = new URLSearchParams(location.hash.slice(1)), given = (key) => Number(wanted.get(key) || 0);
    document.body.classList.toggle("bare", wanted.has("bare"));
    this.timed = wanted.has("times");
    find("mesh").hidden = !avatar.faces;
    this.choose(Math.max(0, avatar.motions.findIndex(({ name }) => name === wanted.get("motion"))));
    this.home = [given("turn"), given("elevation") || 5].map((degrees) => degrees * Math.PI / 180);
    this.reset();
    this.time = Math.min(given("frame"), this.motion.frames - 1);
    for (const id of ["skeleton", "mesh"]) this.press(id, wanted.has(id));
    const still = wanted.has("frame") || matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.press("play", !still && this.motion.frames > 1);
    this.listen();
    requestAnimationFrame((now) => this.step(now, now));
  }

  choose(number) {
    this.motion = this.avatar.motions[number];
    this.time = 0;
    find("motion").selectedIndex = number;
    find("time").max = this.motion.frames - 1;
    find("time").disabled = find("play").disabled = this.motion.frames < 2;
  }

  reset() { this.orbit = new Orbit(this.motion, ...this.home); this.changed = true; }
  press(id, on) { find(id).setAttribute("aria-pressed", on); this.changed = true; }
  pressed(id) { return find(id).getAttribute("aria-pressed") === "true"; }

  turn(turn, elevation) {
    this.orbit.turn += turn;
    this.orbit.elevation = Math.max(-1.5, Math.min(1.5, this.orbit.elevation + elevation));
    this.changed = true;
  }

  zoom(factor) {
    this.orbit.zoom = Math.max(0.2, Math.min(20, this.orbit.zoom * factor));
    this.changed = true;
  }

  move(right, down) { // CSS pixels of the person in the picture
    const { rows, away, focal } = this.camera, metres = away * this.sharpness / focal;
    this.orbit.target = plus(plus(this.orbit.target, -right * metres, rows.x), -down * metres, rows.y);
    this.changed = true;
  }

  listen() {
    for (const id of ["play", "skeleton", "mesh"]) {
      find(id).onclick = () => this.press(id, !this.pressed(id));
    }
    find("reset").onclick = () => this.reset();
    find("motion").onchange = () => { this.choose(find("motion").selectedIndex); this.reset(); };
    find("time").oninput = () => {
      this.time = Number(find("time").value);
      this.press("play", false);
    };
    const keys = {
      ArrowLeft: () => this.turn(-TURN, 0), ArrowRight: () => this.turn(TURN, 0),
      ArrowUp: () => this.turn(0, TURN), ArrowDown: () => this.turn(0, -TURN),
      "+": () => this.zoom(ZOOM), "-": () => this.zoom(1 / ZOOM), " ": () => find("play").click(),
      0: () => this.reset(),
    };
    this.canvas.onkeydown = (event) => {
      if (keys[event.key]) { keys[event.key](); event.preventDefault(); }
    };
    this.canvas.addEventListener("wheel", (event) => {
      this.zoom(ZOOM ** (-Math.sign(event.deltaY)));
      event.preventDefault();
    }, { passive: false });
    const fingers = new Map();
    this.canvas.oncontextmenu = () => false;
    this.canvas.onpointerdown = (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, event);
    };
    this.canvas.onpointerup = this.canvas.onpointercancel = (event) => fingers.delete(event.pointerId);
    this.canvas.onpointermove = (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const [x, y] = [event.clientX - before.clientX, event.clientY - before.clientY];
      const other = [...fingers.values()].find((finger) => finger.pointerId !== event.pointerId);
      if (other) {
        const gap = (finger) => Math.hypot(finger.clientX - other.clientX, finger.clientY - other.clientY);
        this.zoom(gap(event) / Math.max(1, gap(before)));
      }
      if (other || event.shiftKey || event.buttons & 2) this.move(x / (other ? 2 : 1), y / (other ? 2 : 1));
      else this.turn(-x * TURN_PER_PIXEL, y * TURN_PER_PIXEL);
      fingers.set(event.pointerId, event);
    };
    new ResizeObserver(() => { this.changed = true; }).observe(this.canvas);
    this.canvas.addEventListener("webglcontextlost", () => fail("the graphics driver stopped; load the page again"));
  }

  step(before, now) {
    if (this.pressed("play")) {
      this.time = (this.time + (now - before) / 1000 * this.motion.fps) % this.motion.frames;
      this.changed = true;
    }
    if (this.changed) this.draw();
    requestAnimationFrame((next) => this.step(now, next));
  }

  draw() {
    const begun = performance.now();
    this.changed = false;
    this.sharpness = Math.min(devicePixelRatio, SHARPEST);
    const size = [this.canvas.clientWidth, this.canvas.clientHeight].map((x) => Math.round(x * this.sharpness));
    for (const canvas of [this.canvas, find("bones")]) {
      if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    }
    this.camera = this.orbit.see(...size, this.avatar);
    this.painter.pose(this.motion, Math.min(this.time, this.motion.frames - 1));
    this.painter.draw(this.camera, this.pressed("mesh"));
    const context = find("bones").getContext("2d");
    context.clearRect(0, 0, ...size);
    if (this.pressed("skeleton")) this.painter.bones(context, this.camera);
    find("time").value = this.time;
    find("seconds").value = `${(this.time / this.motion.fps).toFixed(1)} s`;
    if (this.timed) find("seconds").value = `${(this.painter.finished() - begun).toFixed(0)} ms`;
    document.body.dataset.drawn = "yes";
  }
}

function fail(reason) {
  find("message").textContent = `The avatar cannot be shown: ${reason}.`;
  find("message").hidden = false;
}

addEventListener("error", (event) => fail(event.message));
readAvatar(find("avatar").textContent).then((avatar) => { window.player = new Player(avatar); })
  .catch((error) => fail(error.message));
