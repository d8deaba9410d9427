// The images on a wall ahead of the person, by plain WebGL: the first in the middle, others to the right, words below.

const AHEAD_M = 1.8, EYES_M = 1.35, LARGE_M = 1.3, SMALL_M = 0.6, GAP_M = 0.05, WORDS_M = 0.16;
const WORDS_PX = [1024, 126];
const VERTEX = `attribute vec2 corner; uniform mat4 projection, view; uniform vec4 box; varying vec2 place;
void main() {
  place = vec2(corner.x, 1.0 - corner.y);
  gl_Position = projection * view * vec4(box.xy + (corner - 0.5) * box.zw, ${(-AHEAD_M).toFixed(3)}, 1.0);
}`;
const FRAGMENT = `precision mediump float; uniform sampler2D image; varying vec2 place;
void main() { gl_FragColor = texture2D(image, place); }`;

export class Wall {
  constructor(gl, seeThrough) {
    this.gl = gl;
    this.ground = seeThrough ? [0, 0, 0, 0] : [0.08, 0.09, 0.11, 1];
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    gl.useProgram(program);
    this.places = Object.fromEntries(["projection", "view", "box"].map((name) => [name, gl.getUniformLocation(program, name)]));
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([0, 0, 1, 0, 0, 1, 1, 1]), gl.STATIC_DRAW);
    const corner = gl.getAttribLocation(program, "corner");
    gl.enableVertexAttribArray(corner);
    gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
    this.textures = [];
    this.words = document.createElement("canvas");
    [this.words.width, this.words.height] = WORDS_PX;
  }

  show(pose, layer, canvases, lines) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    gl.clearColor(...this.ground);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!pose) return;
    this.write(lines);
    const panels = [...canvases, this.words], boxes = layout(canvases);
    panels.forEach((canvas, index) => this.load(canvas, index));
    for (const view of pose.views) {
      const { x, y, width, height } = layer.getViewport(view);
      gl.viewport(x, y, width, height);
      gl.uniformMatrix4fv(this.places.projection, false, view.projectionMatrix);
      gl.uniformMatrix4fv(this.places.view, false, view.transform.inverse.matrix);
      boxes.forEach((box, index) => {
        gl.bindTexture(gl.TEXTURE_2D, this.textures[index]);
        gl.uniform4fv(this.places.box, box);
        gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
      });
    }
  }

  load(canvas, index) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.textures[index] ??= gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, canvas);
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    for (const size of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, size, gl.LINEAR);
  }

  write(lines) {
    const text = lines.join("\n");
    if (text === this.written) return;
    this.written = text;
    const ink = this.words.getContext("2d");
    ink.fillStyle = "#1d2128";
    ink.fillRect(0, 0, ...WORDS_PX);
    ink.fillStyle = "#e9ecf1";
    ink.font = "40px system-ui, sans-serif";
    lines.forEach((line, row) => ink.fillText(line, 20, 48 + 54 * row, WORDS_PX[0] - 40));
  }
}

// Returns the middle (x, y) and size of each image and of the words, in metres of the wall.
export function layout(canvases) {
  const boxes = canvases.map(({ width, height }, index) => {
    const size = index ? SMALL_M : LARGE_M, x = index ? LARGE_M / 2 + GAP_M + SMALL_M / 2 : 0;
    const y = EYES_M + (index ? LARGE_M / 2 - SMALL_M / 2 - (index - 1) * (SMALL_M + GAP_M) : 0);
    const longest = Math.max(width, height);
    return [x, y, size * width / longest, size * height / longest];
  });
  return [...boxes, [0, EYES_M - LARGE_M / 2 - GAP_M - WORDS_M / 2, LARGE_M, WORDS_M]];
}
