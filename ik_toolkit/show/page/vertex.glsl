#version 300 es
in vec3 position; in vec3 normal;
uniform mat4 model, view, lens;
out vec3 seen, facing; out vec2 ground;
void main() {
  vec4 at = model * vec4(position, 1.0);
  ground = at.xy;
  seen = (view * at).xyz;
  facing = mat3(view) * mat3(model) * normal;
  gl_Position = lens * vec4(seen, 1.0);
}
