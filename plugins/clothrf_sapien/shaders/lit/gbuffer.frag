#version 450
#include "../common/buffers.glsl"
#include "../common/surface.glsl"

void main() {
  writeSurface(1.0);
}
