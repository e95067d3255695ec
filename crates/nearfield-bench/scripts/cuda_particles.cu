// The grains of Green2010 by the textbook method, to be compared with `nearfield-bench particles --only green`: cells of one diameter are
// numbered, grains are sorted by the number of their cell with thrust, the first and last of each cell are found, and every grain collides
// with those of 27 cells. Single precision, two buffers, no shared memory. Prints steps a second for 65,536, 250,000 and 1,000,000 grains.
//
// build: nvcc -O3 -std=c++17 -o cuda_particles cuda_particles.cu
// run:   ./cuda_particles [steps]
//
// The start is that of the built-in scene dem-box: a cubic lattice of touching grains with the same jitter, grains smaller beyond 16,384.

#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include <cuda_runtime.h>
#include <thrust/device_ptr.h>
#include <thrust/sort.h>

#define CHECK(call)                                                                                    \
    do {                                                                                               \
        cudaError_t error = (call);                                                                    \
        if (error != cudaSuccess) {                                                                    \
            std::fprintf(stderr, "line %d: %s\n", __LINE__, cudaGetErrorString(error));                \
            std::exit(1);                                                                              \
        }                                                                                              \
    } while (0)

struct Settings {
    unsigned count;
    int cells;  // along each side
    float radius, cell, time_step, gravity, spring, damping, shear, wall_damping;
    float3 ball;
    float ball_radius;
};

__host__ __device__ inline float3 operator+(float3 a, float3 b) { return make_float3(a.x + b.x, a.y + b.y, a.z + b.z); }
__host__ __device__ inline float3 operator-(float3 a, float3 b) { return make_float3(a.x - b.x, a.y - b.y, a.z - b.z); }
__host__ __device__ inline float3 operator*(float s, float3 a) { return make_float3(s * a.x, s * a.y, s * a.z); }
__host__ __device__ inline float dot(float3 a, float3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
__device__ inline float3 xyz(float4 a) { return make_float3(a.x, a.y, a.z); }

__device__ inline int cell_along(float x, const Settings& s) { return min(max(int((x + 1.0f) / s.cell), 0), s.cells - 1); }
__device__ inline unsigned cell_number(int x, int y, int z, const Settings& s) { return (z * s.cells + y) * s.cells + x; }

// One axis: moves, and keeps between the walls.
__device__ inline void move_axis(float& x, float& v, const Settings& s) {
    x += v * s.time_step;
    const float wall = 1.0f - s.radius;
    if (x > wall) { x = wall; v *= s.wall_damping; }
    if (x < -wall) { x = -wall; v *= s.wall_damping; }
}

__global__ void integrate_and_hash(float4* position, float4* velocity, unsigned* cells, unsigned* order, Settings s) {
    const unsigned i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= s.count) return;
    float4 x = position[i], v = velocity[i];
    v.y += s.gravity * s.time_step;
    move_axis(x.x, v.x, s);
    move_axis(x.y, v.y, s);
    move_axis(x.z, v.z, s);
    position[i] = x;
    velocity[i] = v;
    cells[i] = cell_number(cell_along(x.x, s), cell_along(x.y, s), cell_along(x.z, s), s);
    order[i] = i;
}

__global__ void reorder_and_find_starts(const unsigned* cells, const unsigned* order, const float4* position, const float4* velocity,
                                        float4* sorted_position, float4* sorted_velocity, unsigned* start, unsigned* end, unsigned count) {
    const unsigned i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= count) return;
    const unsigned cell = cells[i];
    if (i == 0 || cells[i - 1] != cell) start[cell] = i;
    if (i + 1 == count || cells[i + 1] != cell) end[cell] = i + 1;
    sorted_position[i] = position[order[i]];
    sorted_velocity[i] = velocity[order[i]];
}

__device__ inline float3 push(float3 to_other, float3 relative, float reach, const Settings& s) {
    const float distance = sqrtf(dot(to_other, to_other));
    if (distance >= reach) return make_float3(0.0f, 0.0f, 0.0f);
    const float3 normal = distance > 0.0f ? (1.0f / distance) * to_other : make_float3(0.0f, 0.0f, 0.0f);
    const float3 tangential = relative - dot(relative, normal) * normal;
    return (-s.spring * (reach - distance)) * normal + s.damping * relative + s.shear * tangential;
}

__global__ void collide(const float4* position, const float4* velocity, const unsigned* order, float4* next_position, float4* next_velocity,
                        const unsigned* start, const unsigned* end, Settings s) {
    const unsigned i = blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= s.count) return;
    const float3 x = xyz(position[i]), v = xyz(velocity[i]);
    float3 sum = make_float3(0.0f, 0.0f, 0.0f);
    const int cx = cell_along(x.x, s), cy = cell_along(x.y, s), cz = cell_along(x.z, s);
    for (int z = max(cz - 1, 0); z <= min(cz + 1, s.cells - 1); ++z)
        for (int y = max(cy - 1, 0); y <= min(cy + 1, s.cells - 1); ++y)
            for (int nx = max(cx - 1, 0); nx <= min(cx + 1, s.cells - 1); ++nx) {
                const unsigned cell = cell_number(nx, y, z, s);
                const unsigned first = start[cell];
                if (first == 0xffffffffu) continue;
                for (unsigned j = first; j < end[cell]; ++j)
                    if (j != i) sum = sum + push(xyz(position[j]) - x, xyz(velocity[j]) - v, 2.0f * s.radius, s);
            }
    sum = sum + push(s.ball - x, -1.0f * v, s.radius + s.ball_radius, s);
    const unsigned own = order[i];
    next_position[own] = position[i];
    next_velocity[own] = make_float4(v.x + sum.x, v.y + sum.y, v.z + sum.z, 0.0f);
}

static void measure(unsigned count, unsigned steps) {
    const double scale = std::fmax(std::cbrt(count / 16384.0), 1.0);
    const float radius = float(1.0 / 64.0 / scale);
    const int side = int(1.0f / radius);
    Settings s{count, side, radius, 2.0f / side, 0.5f, -0.0003f, 0.5f, 0.02f, 0.1f, -0.5f, make_float3(-1.2f, -0.8f, 0.8f), 0.2f};
    unsigned edge = 1, random = 1973;
    while (size_t(edge) * edge * edge < count) ++edge;
    const auto jitter = [&] {
        random = random * 1664525u + 1013904223u;
        return float((2.0 * (random / 4294967296.0) - 1.0) * 0.01 * radius);
    };
    std::vector<float4> host(count);
    for (unsigned i = 0; i < count; ++i) {
        const float x = 2.0f * radius * (i % edge) + radius - 1.0f + jitter(), y = 2.0f * radius * (i / edge % edge) + radius - 1.0f + jitter();
        const float z = 2.0f * radius * (i / edge / edge) + radius - 1.0f + jitter();
        host[i] = make_float4(x, y, z, 0.0f);
    }
    const size_t bytes = count * sizeof(float4), table = size_t(side) * side * side * sizeof(unsigned);
    float4 *position, *velocity, *sorted_position, *sorted_velocity;
    unsigned *cells, *order, *start, *end;
    CHECK(cudaMalloc(&position, bytes));
    CHECK(cudaMalloc(&velocity, bytes));
    CHECK(cudaMalloc(&sorted_position, bytes));
    CHECK(cudaMalloc(&sorted_velocity, bytes));
    CHECK(cudaMalloc(&cells, count * sizeof(unsigned)));
    CHECK(cudaMalloc(&order, count * sizeof(unsigned)));
    CHECK(cudaMalloc(&start, table));
    CHECK(cudaMalloc(&end, table));
    const unsigned blocks = (count + 255) / 256;
    const auto advance = [&](unsigned n) {
        for (unsigned step = 0; step < n; ++step) {
            integrate_and_hash<<<blocks, 256>>>(position, velocity, cells, order, s);
            thrust::sort_by_key(thrust::device_ptr<unsigned>(cells), thrust::device_ptr<unsigned>(cells) + count, thrust::device_ptr<unsigned>(order));
            CHECK(cudaMemsetAsync(start, 0xff, table));
            reorder_and_find_starts<<<blocks, 256>>>(cells, order, position, velocity, sorted_position, sorted_velocity, start, end, count);
            collide<<<blocks, 256>>>(sorted_position, sorted_velocity, order, position, velocity, start, end, s);
        }
        CHECK(cudaDeviceSynchronize());
    };
    const auto reset = [&] {
        CHECK(cudaMemcpy(position, host.data(), bytes, cudaMemcpyHostToDevice));
        CHECK(cudaMemset(velocity, 0, bytes));
    };
    reset();
    advance(200);
    reset();
    const auto begin = std::chrono::steady_clock::now();
    advance(steps);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    std::vector<float4> end_state(count);
    CHECK(cudaMemcpy(end_state.data(), position, bytes, cudaMemcpyDeviceToHost));
    double height = 0.0;
    for (const float4& p : end_state) height += p.y / count;
    std::printf("%8u grains: %10.1f steps a second, mean height %.6f after %u steps\n", count, steps / seconds, height, steps);
    for (void* memory : {(void*)position, (void*)velocity, (void*)sorted_position, (void*)sorted_velocity, (void*)cells, (void*)order, (void*)start, (void*)end})
        CHECK(cudaFree(memory));
}

int main(int argc, char** argv) {
    const unsigned steps = argc > 1 ? unsigned(std::strtoul(argv[1], nullptr, 10)) : 2000;
    if (steps == 0) { std::fprintf(stderr, "usage: cuda_particles [steps above 0]\n"); return 2; }
    for (const unsigned count : {65536u, 250000u, 1000000u}) measure(count, steps);
    return 0;
}
