// Random quadratic programmes, most of them hostile.
#include <cstdio>
#include <limits>
#include <random>

#include "gainroom/quadratic_programme.hpp"

using namespace gainroom;

static std::mt19937 generator(7);

static std::vector<double> numbers(std::size_t count, bool hostile) {
    using Limits = std::numeric_limits<double>;
    static const double odd[] = {0.0, -0.0, 1e300, -1e300, 5e-324, Limits::infinity(), -Limits::infinity(), Limits::quiet_NaN()};
    std::vector<double> found(count);
    for (double& one : found) one = hostile && generator() % 8 == 0 ? odd[generator() % 8] : std::normal_distribution<double>()(generator);
    return found;
}

// Whether all that is found is finite and within its limits.
static bool solved(bool hostile) {
    const std::size_t n = generator() % 12, m = generator() % 30;
    std::vector<double> bend = numbers(n, hostile), low = numbers(n, hostile), high = numbers(n, hostile);
    if (!hostile)
        for (std::size_t k = 0; k < n; k++) {
            bend[k] = 0.01 + std::fabs(bend[k]);
            low[k] = -std::fabs(low[k]);
            high[k] = std::fabs(high[k]);
        }
    const std::vector<double> found = quadratic_programme(bend, numbers(n, hostile), numbers(m * n, hostile).data(), numbers(m, hostile),
                                                          hostile ? numbers(1, true)[0] : 10.0, low, high);
    bool within = found.size() == n + 1 && std::isfinite(found[n]) && found[n] >= 0.0;
    for (std::size_t k = 0; k < n; k++) within = within && found[k] >= low[k] && found[k] <= high[k];
    return within;
}

int main() {
    int ordinary = 0, every = 0;
    for (int number = 0; number < 400; number++) {
        const bool hostile = number % 4 != 0, within = solved(hostile);
        if (!hostile) ordinary += within, every++;
    }
    std::printf("%d %d\n", ordinary, every);
}
