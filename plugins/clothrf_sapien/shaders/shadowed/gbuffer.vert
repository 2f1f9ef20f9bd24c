#version 450
#include "../common/buffers.glsl"
#include "../common/vertex.glsl"
