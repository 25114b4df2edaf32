// Random and hostile modes and matrices through disk_peak.hpp: it ends, and stays inside its memory. Prints how many of the ordinary loops
// were bounded.
#include <cstdio>
#include <limits>
#include <random>

#include "gainroom/disk_peak.hpp"

using gainroom::Complex;
using gainroom::Dense;
using gainroom::DiskModes;

static DiskModes draw(std::mt19937& engine, std::size_t n, std::size_t m, bool pairs, double step) {
    std::uniform_real_distribution<double> uniform(0.0, 1.0);
    DiskModes modes;
    modes.size = n;
    modes.step = step;
    for (std::size_t i = 0; i < n; i++) {
        modes.delays.push_back(step > 0 ? 2 * step : 3e-3 * uniform(engine));
        modes.share.push_back(0.9 + 0.2 * uniform(engine));
    }
    for (std::size_t k = 0; k < m; k++) {
        const bool second = pairs && k % 2 == 1;
        modes.poles.push_back(second ? std::conj(modes.poles.back()) : Complex(-1 - 99 * uniform(engine), 300 * uniform(engine)));
        for (std::size_t i = 0; i < n; i++) {
            const Complex out(uniform(engine) - 0.5, uniform(engine) - 0.5), into(uniform(engine) - 0.5, uniform(engine) - 0.5);
            modes.out.push_back(second ? std::conj(modes.out[(k - 1) * n + i]) : out);
            modes.into.push_back(second ? std::conj(modes.into[(k - 1) * n + i]) : 30.0 * into);
        }
    }
    return modes;
}

static bool bounded(const DiskModes& modes, std::size_t most) {
    std::vector<double> omega = {0.0};
    for (double place = 1.0; place < std::min(3000.0, modes.last()); place *= 1.2) omega.push_back(place);
    gainroom::DiskBound found(modes);
    found.search(omega.data(), omega.size(), most);
    return std::isfinite(found.bound);
}

static void hostile_matrices(std::mt19937& engine, const std::vector<double>& odd) {
    std::normal_distribution<double> normal;
    for (std::size_t n = 1; n < 9; n++)
        for (const double value : odd) {
            Dense matrix;
            matrix.resize(n, n);
            for (std::size_t k = 0; k < n * n; k++) matrix.re[k] = normal(engine);
            matrix.im[n * n - 1] = value;
            std::vector<double> x(n, 0.0);
            std::vector<Complex> phases(n);
            gainroom::StructuredValue mu(n);
            mu.balance(matrix, x.data());
            mu.improve(matrix, x.data(), 1e-7);
            mu.from_below(matrix, phases.data(), std::numeric_limits<double>::infinity());
        }
}

int main() {
    std::mt19937 engine(1);
    const double infinite = std::numeric_limits<double>::infinity();
    const std::vector<double> odd = {0.0, 1e300, -1e300, 5e-324, infinite, -infinite, std::numeric_limits<double>::quiet_NaN()};
    int ordinary = 0, others = 0;
    for (int k = 0; k < 24; k++) {
        const std::size_t n = 1 + k % 8;
        const DiskModes modes = draw(engine, n, 2 * (k % 5) * n, k % 2 == 0, k % 3 == 2 ? 1e-3 : 0.0);
        ordinary += bounded(modes, 3000);
        for (const double value : odd) {
            for (int place = 0; place < 6; place++) {
                DiskModes other = modes;
                if (place == 0) other.delays[0] = value;
                if (place == 1) other.share[0] = value;
                if (place == 2 && !other.poles.empty()) other.poles[0] = {value, other.poles[0].imag()};
                if (place == 3 && !other.poles.empty()) other.poles[0] = {other.poles[0].real(), value};
                if (place == 4 && !other.into.empty()) other.into[0] = value;
                if (place == 5 && !other.out.empty()) other.out.back() = value;
                const bool proved = bounded(other, 30), felt = place < 2 || !other.poles.empty();
                if (proved && felt && !std::isfinite(value)) return 1;
                others += proved;
            }
        }
    }
    hostile_matrices(engine, odd);
    std::printf("%d %d\n", ordinary, others);
}
