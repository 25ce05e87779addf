// A small WebGL 2 renderer: lit meshes, translucent copies, a floor with grid and shadow, and handles on top.
import { cross, plus, point, times, unit } from "./robot.js";

const LIT = 0, HANDLE = 0.4, FLAT = 1, GRID = 2; // how a shape is shaded: see fragment.glsl
const PALE = 0.25, SAME = 3e-3; // opacity of a ghost; [sizes of the robot, rad] parts nearer than this are seen as one
const matrix = (T) => new Float32Array([T[0], T[4], T[8], 0, T[1], T[5], T[9], 0, T[2], T[6], T[10], 0, T[3], T[7], T[11], 1]);

// Placement of a shape of unit height that stretches from one point to another, `thick` across.
export function standing(from, to, thick) {
  const z = plus(to, from, -1), x = unit(cross(z, Math.abs(unit(z)[2]) > 0.9 ? [1, 0, 0] : [0, 0, 1])), y = cross(unit(z), x);
  return [0, 1, 2].flatMap((r) => [thick * x[r], thick * y[r], z[r], from[r]]);
}

// Placement of a part, `frames` the placements of the nodes: of a bar from its own place to its end's.
export function seat({ node, T, end, thick }, frames) {
  const own = node < 0 ? T : times(frames[node], T);
  return end ? standing(point(own), point(seat(end, frames)), thick) : own;
}

export class Renderer {
  // data: parts, each with its shapes, and the shapes of the handles by name; blob: the triangles of all of them in that order.
  constructor(canvas, shaders, { parts, handles, room }, blob) {
    const gl = canvas.getContext("webgl2", { alpha: false, stencil: true, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This page needs a browser with WebGL 2.");
    Object.assign(this, { canvas, gl, blob, size: room.size, read: 0, program: gl.createProgram(), at: {} });
    for (const [kind, text] of [[gl.VERTEX_SHADER, shaders.vertex], [gl.FRAGMENT_SHADER, shaders.fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
    }
    ["position", "normal"].forEach((name, k) => gl.bindAttribLocation(this.program, k, name));
    for (const step of ["linkProgram", "useProgram"]) gl[step](this.program);
    for (const name of ["model", "view", "lens", "color", "up", "kind", "cell", "wide"]) this.at[name] = gl.getUniformLocation(this.program, name);
    for (const what of [gl.DEPTH_TEST, gl.BLEND]) gl.enable(what);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthFunc(gl.LEQUAL);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    this.parts = parts.map((part) => ({ ...part, shapes: part.shapes.map((shape) => this.load(shape)) }));
    this.handles = Object.fromEntries(Object.entries(handles).map(([name, shape]) => [name, this.load(shape)]));
  }

  load({ color, opacity, low, size, vertices, faces }) {
    const { gl } = this, array = gl.createVertexArray();
    const take = (Kind, count) => { // a copy: a typed array must begin at a multiple of its element size
      this.read += 3 * count * Kind.BYTES_PER_ELEMENT;
      return new Kind(this.blob.slice(this.read - 3 * count * Kind.BYTES_PER_ELEMENT, this.read));
    };
    const positions = Float32Array.from(take(Uint16Array, vertices), (x, i) => low[i % 3] + (x / 65535) * size[i % 3]);
    gl.bindVertexArray(array);
    [[positions, gl.FLOAT, false], [take(Int8Array, vertices), gl.BYTE, true]].forEach(([values, kind, whole], k) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(k);
      gl.vertexAttribPointer(k, 3, kind, whole, 0, 0);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, take(Uint32Array, faces), gl.STATIC_DRAW);
    return { color, opacity, array, count: 3 * faces };
  }

  one(shape, T, kind, color = shape.color, alpha = shape.opacity) {
    const { gl, at } = this;
    gl.uniformMatrix4fv(at.model, false, matrix(T));
    gl.uniform4f(at.color, ...color, alpha);
    gl.uniform1f(at.kind, kind);
    gl.bindVertexArray(shape.array);
    gl.drawElements(gl.TRIANGLES, shape.count, gl.UNSIGNED_INT, 0);
  }

  // The robot's parts, `frames` the nodes' placements in the world; with a colour, all in it. Not those that one of `others` has there.
  robot(frames, kind, color, alpha, others = []) {
    const same = (A, B) => plus(A, B, -1).every((x, i) => Math.abs(x) < (i % 4 === 3 ? SAME * this.size : SAME));
    for (const part of this.parts) {
      const nodes = [part, part.end ?? part].map(({ node }) => node);
      if (others.some((other) => nodes.every((node) => node < 0 || same(other[node], frames[node])))) continue;
      for (const shape of part.shapes) this.one(shape, seat(part, frames), kind, color, alpha);
    }
  }

  // A picture: camera {view, lens}, colours {back, line, dark}, floor {z, cell, wide}, robots (frames; but for the
  // first ghosts in a color) and handles (shape, T, color, alpha), drawn on top.
  draw(camera, { back, line, dark }, { z, cell, wide }, robots, handles) {
    const { gl, at, canvas } = this, [x, y] = [0.35, -0.2], view = (T) => gl.uniformMatrix4fv(at.view, false, matrix(T));
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...back, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.uniformMatrix4fv(at.lens, false, camera.lens);
    gl.uniform3f(at.up, camera.view[2], camera.view[6], camera.view[10]);
    for (const [name, size] of Object.entries({ cell, wide })) gl.uniform1f(at[name], size);
    view(camera.view);
    this.robot(robots[0].frames, LIT);
    gl.depthMask(false);
    this.one(this.handles.floor, standing([0, 0, z], [0, 0, z + 1], wide), GRID, line, 0.7);
    gl.enable(gl.STENCIL_TEST); // each pixel is shaded once, however many parts lie over it
    gl.stencilFunc(gl.EQUAL, 0, 1);
    view(times(camera.view, [1, 0, x, -x * z, 0, 1, y, -y * z, 0, 0, 0, z])); // x, y: how far a shadow falls sideways per metre of height
    this.robot(robots[0].frames, FLAT, dark, 0.17);
    view(camera.view);
    gl.disable(gl.STENCIL_TEST);
    gl.depthMask(true);
    robots.slice(1).forEach(({ frames, color }, k) => { // a ghost shows only its front, and not through the robot: depths are drawn first
      const others = robots.slice(0, k + 1).map((one) => one.frames);
      gl.clear(gl.DEPTH_BUFFER_BIT);
      gl.colorMask(false, false, false, false);
      this.robot(others[0], LIT);
      this.robot(frames, LIT, undefined, 1, others);
      gl.colorMask(true, true, true, true);
      this.robot(frames, LIT, color, PALE, others);
    });
    gl.clear(gl.DEPTH_BUFFER_BIT);
    for (const { shape, T, color, alpha } of handles) this.one(this.handles[shape], T, HANDLE, color, alpha);
  }
}
