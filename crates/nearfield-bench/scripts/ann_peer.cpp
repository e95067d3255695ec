// Exact search by libann: the k nearest of every point (itself first) and the number within a radius, on one thread.
//
//   ann_peer POINTS DIMENSION N K RADIUS OUTPUT
//
// POINTS holds n · dimension 32-bit floats, OUTPUT gets n · k indices (0xffffffff where there is no point) and n counts,
// all little endian. Prints three times in milliseconds: build, k nearest, counts.

#include <ANN/ANN.h>

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <vector>

using Clock = std::chrono::steady_clock;

static double milliseconds(Clock::time_point from) {
    return std::chrono::duration<double, std::milli>(Clock::now() - from).count();
}

int main(int argc, char** argv) {
    if (argc != 7) {
        std::fprintf(stderr, "usage: ann_peer POINTS DIMENSION N K RADIUS OUTPUT\n");
        return 2;
    }
    const int dimension = std::atoi(argv[2]), n = std::atoi(argv[3]), k = std::atoi(argv[4]);
    const double radius = std::atof(argv[5]);
    std::vector<float> coordinates(static_cast<size_t>(n) * dimension);
    std::FILE* input = std::fopen(argv[1], "rb");
    if (!input || std::fread(coordinates.data(), sizeof(float), coordinates.size(), input) != coordinates.size()) {
        std::fprintf(stderr, "%s: cannot read %d points of %d coordinates\n", argv[1], n, dimension);
        return 1;
    }
    std::fclose(input);
    ANNpointArray points = annAllocPts(n, dimension);
    for (int i = 0; i < n; i++)
        for (int axis = 0; axis < dimension; axis++) points[i][axis] = coordinates[static_cast<size_t>(i) * dimension + axis];

    auto start = Clock::now();
    ANNkd_tree tree(points, n, dimension);
    const double build = milliseconds(start);

    const int places = k < n ? k : n;
    std::vector<uint32_t> answer(static_cast<size_t>(n) * k, UINT32_MAX);
    std::vector<ANNidx> ids(places);
    std::vector<ANNdist> distances(places);
    start = Clock::now();
    for (int i = 0; i < n; i++) {
        tree.annkSearch(points[i], places, ids.data(), distances.data(), 0.0);
        for (int j = 0; j < places; j++) answer[static_cast<size_t>(i) * k + j] = static_cast<uint32_t>(ids[j]);
    }
    const double nearest = milliseconds(start);

    std::vector<uint32_t> counts(n);
    start = Clock::now();
    // With no places to fill, libann counts.
    for (int i = 0; i < n; i++)
        counts[i] = static_cast<uint32_t>(tree.annkFRSearch(points[i], radius * radius, 0, nullptr, nullptr, 0.0));
    const double counted = milliseconds(start);

    std::FILE* output = std::fopen(argv[6], "wb");
    bool written = output && std::fwrite(answer.data(), 4, answer.size(), output) == answer.size() &&
                   std::fwrite(counts.data(), 4, counts.size(), output) == counts.size();
    if (!output || std::fclose(output) != 0 || !written) {
        std::fprintf(stderr, "%s: cannot write the answer\n", argv[6]);
        return 1;
    }
    std::printf("%.3f %.3f %.3f\n", build, nearest, counted);
    annDeallocPts(points);
    annClose();
    return 0;
}
