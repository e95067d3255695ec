// Weighted locally optimal projection by CGAL, on one thread.
//
//   cgal_peer POINTS N PERCENT RADIUS ITERATIONS UNIFORM OUTPUT
//
// POINTS holds n · 3 64-bit floats, little endian as all files here. PERCENT of them are the samples; a negative RADIUS takes
// CGAL's default; UNIFORM is 1 for `require_uniform_sampling`. CGAL shuffles the points in place and takes the last ones as
// its first samples: OUTPUT gets these, and then the samples after all iterations in the same order, each s · 3 64-bit floats.
// Prints CGAL's version, s, its default radius and the time in milliseconds.

#include <CGAL/Simple_cartesian.h>
#include <CGAL/compute_average_spacing.h>
#include <CGAL/version.h>
#include <CGAL/wlop_simplify_and_regularize_point_set.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <iterator>
#include <vector>

using Kernel = CGAL::Simple_cartesian<double>;
using Point = Kernel::Point_3;

static bool write(std::FILE* file, const Point* points, size_t count) {
    for (size_t i = 0; i < count; i++) {
        const double xyz[3] = {points[i].x(), points[i].y(), points[i].z()};
        if (std::fwrite(xyz, sizeof(double), 3, file) != 3) return false;
    }
    return true;
}

int main(int argc, char** argv) {
    if (argc != 8) {
        std::fprintf(stderr, "usage: cgal_peer POINTS N PERCENT RADIUS ITERATIONS UNIFORM OUTPUT\n");
        return 2;
    }
    const size_t n = std::strtoull(argv[2], nullptr, 10);
    const double percent = std::atof(argv[3]), radius = std::atof(argv[4]);
    const unsigned iterations = static_cast<unsigned>(std::atoi(argv[5]));
    const bool uniform = std::atoi(argv[6]) != 0;
    std::vector<double> coordinates(3 * n);
    std::FILE* input = std::fopen(argv[1], "rb");
    if (!input || std::fread(coordinates.data(), sizeof(double), coordinates.size(), input) != coordinates.size()) {
        std::fprintf(stderr, "%s: cannot read %zu points\n", argv[1], n);
        return 1;
    }
    std::fclose(input);
    std::vector<Point> points;
    for (size_t i = 0; i < n; i++) points.emplace_back(coordinates[3 * i], coordinates[3 * i + 1], coordinates[3 * i + 2]);
    const double usual = 8.0 * CGAL::compute_average_spacing<CGAL::Sequential_tag>(points, 6);

    std::vector<Point> samples;
    const auto start = std::chrono::steady_clock::now();
    CGAL::wlop_simplify_and_regularize_point_set<CGAL::Sequential_tag>(
        points, std::back_inserter(samples),
        CGAL::parameters::select_percentage(percent)
            .neighbor_radius(radius < 0 ? usual : radius)
            .number_of_iterations(iterations)
            .require_uniform_sampling(uniform));
    const double milliseconds = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();

    std::FILE* output = std::fopen(argv[7], "wb");
    const bool written = output && write(output, points.data() + (n - samples.size()), samples.size()) &&
                         write(output, samples.data(), samples.size());
    if (!output || std::fclose(output) != 0 || !written) {
        std::fprintf(stderr, "%s: cannot write the samples\n", argv[7]);
        return 1;
    }
    std::printf("%s %zu %.17g %.3f\n", CGAL_VERSION_STR, samples.size(), usual, milliseconds);
    return 0;
}
