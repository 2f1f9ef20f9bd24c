layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 uv;
layout(location = 3) in vec3 tangent;
layout(location = 4) in vec3 bitangent;

layout(location = 0) out vec3 outCamera;
layout(location = 1) out vec3 outWorld;
layout(location = 2) out vec3 outNormal;
layout(location = 3) out vec2 outPlace;

void main() {
  vec4 world = objectTransformBuffer.modelMatrix * vec4(position, 1.0);
  vec4 camera = cameraBuffer.viewMatrix * world;
  outWorld = world.xyz;
  outCamera = camera.xyz;
  outPlace = uv;
  outNormal = mat3(objectTransformBuffer.modelMatrix) * normal;
  gl_Position = cameraBuffer.projectionMatrix * camera;
}
