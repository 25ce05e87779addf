#version 300 es
precision highp float;
in vec3 seen, facing; in vec2 ground;
uniform vec4 color; uniform vec3 up; uniform float kind, cell, wide;
out vec4 pixel;
void main() {
  if (kind > 1.5) { // the floor: lines of a grid that fade away
    vec2 steps = ground / cell, off = abs(fract(steps - 0.5) - 0.5) / fwidth(steps);
    float line = 1.0 - min(min(off.x, off.y), 1.0);
    pixel = vec4(color.rgb, color.a * line * smoothstep(1.0, 0.25, length(ground) / wide));
  } else { // kind 0 is lit, 1 has its own colour, handles are between
    vec3 n = normalize(facing), eye = -normalize(seen), sun = normalize(vec3(0.45, 0.75, 0.75));
    if (dot(n, eye) < 0.0) n = -n;
    float day = 0.42 + 0.16 * dot(n, up) + 0.48 * max(dot(n, sun), 0.0);
    float shine = 0.16 * pow(max(dot(n, normalize(sun + eye)), 0.0), 32.0);
    pixel = vec4(mix(color.rgb * day + shine, color.rgb, kind), color.a);
  }
}
