// Scans loops from standard input with the core's headers alone, as a robot's controller would: one line per loop, numbers in hexadecimal.
#include <cstdio>

#include "gainroom/scan.hpp"
#include "input.hpp"

int main() {
    int zeros = 0, poles = 0;
    double gain = 0.0, delay = 0.0, sample_time = 0.0;
    while (std::scanf("%d %d %la %la %la", &zeros, &poles, &gain, &delay, &sample_time) == 5) {
        const auto zero = pairs(zeros), pole = pairs(poles);
        const gainroom::Response loop(zero.data(), zero.size(), pole.data(), pole.size(), gain, delay, sample_time);
        const gainroom::Scan found = gainroom::scan(loop, true);
        const double sizes[] = {double(found.certified), double(found.gains.size()), double(found.phases.size())};
        std::printf("%a %a %a %a", sizes[0], sizes[1], sizes[2], found.half_turns);
        for (const auto& crossing : found.gains) std::printf(" %a %a", crossing.omega, crossing.phase);
        for (const auto& crossing : found.phases) std::printf(" %a %a %a", crossing.omega, crossing.size, crossing.rising);
        for (const auto& peak : found.peaks) std::printf(" %a %a", peak.omega, peak.lowest);
        std::printf("\n");
    }
}
