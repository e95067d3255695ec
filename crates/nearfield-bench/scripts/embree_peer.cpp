// Casts rays into a mesh by Embree, for `nearfield-bench rays --embree PROGRAM`.
//
//   embree_peer VERTICES TRIANGLES RAYS OUTPUT THREADS RUNS MODE
//
// VERTICES has three floats a vertex, TRIANGLES three uint32 a triangle, RAYS eight floats a ray: origin, smallest t,
// direction, largest t. OUTPUT gets 16 bytes a ray: triangle (UINT32_MAX where there is none), t, u, v. MODE is "robust" or
// "fast", Embree's own words for its scenes. Rays are cast one at a time, in order, in parts that THREADS threads take as they
// are free. Prints milliseconds of the build and the median of RUNS casts after one to warm up.
#include <embree3/rtcore.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <string>
#include <thread>
#include <vector>

using Clock = std::chrono::steady_clock;

static double milliseconds(Clock::time_point start) {
    return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

template <typename T>
static std::vector<T> read(const char* path) {
    std::FILE* file = std::fopen(path, "rb");
    if (!file) {
        std::fprintf(stderr, "%s: cannot be opened\n", path);
        std::exit(1);
    }
    std::fseek(file, 0, SEEK_END);
    std::vector<T> values(static_cast<size_t>(std::ftell(file)) / sizeof(T));
    std::rewind(file);
    if (std::fread(values.data(), sizeof(T), values.size(), file) != values.size()) {
        std::fprintf(stderr, "%s: cannot be read\n", path);
        std::exit(1);
    }
    std::fclose(file);
    return values;
}

struct Hit {
    uint32_t triangle;
    float t, u, v;
};

int main(int argc, char** argv) {
    const bool robust = argc == 8 && std::strcmp(argv[7], "robust") == 0;
    if (argc != 8 || (!robust && std::strcmp(argv[7], "fast") != 0)) {
        std::fprintf(stderr, "usage: embree_peer VERTICES TRIANGLES RAYS OUTPUT THREADS RUNS robust|fast\n");
        return 2;
    }
    const std::vector<float> vertices = read<float>(argv[1]);
    const std::vector<uint32_t> triangles = read<uint32_t>(argv[2]);
    const std::vector<float> rays = read<float>(argv[3]);
    const int threads = std::max(1, std::atoi(argv[5])), runs = std::max(1, std::atoi(argv[6]));

    const std::string config = "threads=" + std::to_string(threads);
    RTCDevice device = rtcNewDevice(config.c_str());
    auto start = Clock::now();
    RTCScene scene = rtcNewScene(device);
    rtcSetSceneFlags(scene, robust ? RTC_SCENE_FLAG_ROBUST : RTC_SCENE_FLAG_NONE);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    void* to = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, vertices.size() / 3);
    std::memcpy(to, vertices.data(), vertices.size() * 4);
    to = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, triangles.size() / 3);
    std::memcpy(to, triangles.data(), triangles.size() * 4);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene);
    const double build = milliseconds(start);

    const size_t n = rays.size() / 8, part = 1024;
    std::vector<Hit> hits(n);
    std::vector<double> times;
    for (int run = 0; run <= runs; run++) {
        std::atomic<size_t> next{0};
        const auto cast = [&] {
            RTCIntersectContext context;
            rtcInitIntersectContext(&context);
            for (size_t begin; (begin = next.fetch_add(part)) < n;) {
                for (size_t i = begin; i < std::min(n, begin + part); i++) {
                    const float* ray = &rays[8 * i];
                    RTCRayHit query = {};
                    query.ray.org_x = ray[0], query.ray.org_y = ray[1], query.ray.org_z = ray[2];
                    query.ray.tnear = ray[3];
                    query.ray.dir_x = ray[4], query.ray.dir_y = ray[5], query.ray.dir_z = ray[6];
                    query.ray.tfar = ray[7];
                    query.ray.mask = UINT32_MAX;
                    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
                    rtcIntersect1(scene, &context, &query);
                    const bool found = query.hit.geomID != RTC_INVALID_GEOMETRY_ID;
                    hits[i] = {found ? query.hit.primID : UINT32_MAX,
                               found ? query.ray.tfar : std::numeric_limits<float>::infinity(), query.hit.u, query.hit.v};
                }
            }
        };
        start = Clock::now();
        std::vector<std::thread> team;
        for (int i = 1; i < threads; i++) team.emplace_back(cast);
        cast();
        for (std::thread& member : team) member.join();
        if (run > 0) times.push_back(milliseconds(start));
    }
    std::sort(times.begin(), times.end());

    std::FILE* output = std::fopen(argv[4], "wb");
    bool written = output && std::fwrite(hits.data(), sizeof(Hit), n, output) == n;
    if (!output || std::fclose(output) != 0 || !written) {
        std::fprintf(stderr, "%s: cannot be written\n", argv[4]);
        return 1;
    }
    std::printf("%.3f %.3f\n", build, times[times.size() / 2]);
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
    return 0;
}
