// Delay margins of sampled loops from standard input with the core's headers alone: one line per loop, numbers in hexadecimal.
#include <cstdio>

#include "gainroom/scalar_delay_margin.hpp"
#include "input.hpp"

int main() {
    int zeros = 0, poles = 0, control_zeros = 0, control_poles = 0, crossings = 0, unstable = 0;
    double gain = 0.0, delay = 0.0, control_gain = 0.0, sample_time = 0.0;
    while (std::scanf("%d %d %d %d %d %d %la %la %la %la", &zeros, &poles, &control_zeros, &control_poles, &crossings, &unstable, &gain, &delay,
                      &control_gain, &sample_time) == 10) {
        const auto zero = pairs(zeros), pole = pairs(poles);
        const gainroom::Factors control{pairs(control_zeros), pairs(control_poles), control_gain};
        std::vector<std::array<double, 2>> starts;
        for (const gainroom::Complex start : pairs(crossings)) starts.push_back({start.real(), start.imag()});
        const gainroom::Sampler plant(zero.data(), zero.size(), pole.data(), pole.size(), gain, sample_time);
        const auto found = gainroom::DelayedLoop(plant, control, delay, sample_time, unstable).margin(starts);
        std::printf("%d %a %a\n", static_cast<int>(found.found), found.extra, found.omega);
    }
}
