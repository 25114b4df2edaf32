// Quantities that the margins minimise along the stability boundary: |1+L| (Ms), |1+L|/|L| (Mt), 2|1+L|/|1−L| (disk margin).
#pragma once

#include "response.hpp"

namespace gainroom {

enum Kind { kSensitivity, kComplementary, kDisk, kKinds };

inline double objective(int kind, Complex value) {
    const double below = kind == kSensitivity ? 1.0 : kind == kComplementary ? size_of_any(value) : size_of_any(1.0 - value) / 2;
    return below > 0 ? size_of_any(1.0 + value) / below : kInfinite;
}

// Lower bound of `objective` for log|L| and arg L within these ranges.
inline double objective_bound(int kind, double log_low, double log_high, double phase_low, double phase_high) {
    const double nearest = kPi * (2 * std::floor(0.5 * (phase_low + phase_high) / (2 * kPi)) + 1);
    const double offset = std::max({0.0, phase_low - nearest, nearest - phase_high});  // of arg L from the nearest odd multiple of π
    const double cosine = std::cos(std::min(offset, kPi));
    if (kind == kComplementary) {
        const double kept = log_low;
        log_low = -log_high;
        log_high = -kept;
    }
    const double low = std::exp(std::min(log_low, 300.0)), high = std::exp(std::min(log_high, 300.0));
    if (kind == kDisk) {
        double size = std::min(std::max(1.0, low), high);
        if (cosine < 0) size = low * high < 1 ? low : high;  // right of the imaginary axis: the farther from unity, the closer to −1
        const double closeness = size > 0 ? cosine * 2 / (size + 1 / size) : 0.0;
        return closeness > -1 ? 2 * std::sqrt(std::max(0.0, 1 - closeness) / (1 + closeness)) : kInfinite;
    }
    const double magnitude = std::min(std::max(cosine, low), high);
    return std::sqrt(std::max(0.0, 1 + magnitude * magnitude - 2 * magnitude * cosine));
}

// d log(objective)/dω at a response with these slopes.
inline double inclination(int kind, Complex value, const std::vector<Slope>& slopes, double delay) {
    Complex rate(0.0, -delay);
    for (const Slope& slope : slopes) rate += Complex(slope.size, slope.turn);
    const Complex moved = times(value, rate);
    double result = over(moved, 1.0 + value).real();
    if (kind == kComplementary) result -= rate.real();
    if (kind == kDisk) result += over(moved, 1.0 - value).real();
    return result;
}

struct Peak {
    double omega, lowest;
};

// The local minimum next to `peak`: steps grow downhill and shrink at the bottom; once they are small, a secant on the inclination jumps
// to the bottom, if it is one.
inline Peak polished(int kind, Peak peak, const Response& loop, std::vector<Slope>& slopes) {
    double step = 0.01 * peak.omega;
    const double last = loop.sample_time > 0 ? kPi / loop.sample_time : kInfinite;
    for (int round = 0, jumps = 0; round < 200; round++) {
        if (std::fabs(step) <= 1e-9 * peak.omega) break;  // the minimum is flat: its value is then good to about 1e-16
        if (jumps < 6 && std::fabs(step) < 1e-3 * peak.omega) {
            jumps++;
            const double beside = peak.omega + 1e-3 * step;
            const Complex value = loop.at(peak.omega, slopes.data());
            const double here = inclination(kind, value, slopes, loop.delay);
            const Complex other = loop.at(beside, slopes.data());
            const double there = inclination(kind, other, slopes, loop.delay);
            const double trial = there != here ? peak.omega - here * (beside - peak.omega) / (there - here) : peak.omega;
            if (std::fabs(trial - peak.omega) < 10 * std::fabs(step) && trial <= last) {
                const double reached = objective(kind, loop.at(trial));
                if (reached <= peak.lowest * (1 + 1e-15)) {
                    step = std::min(std::fabs(step), std::max(std::fabs(trial - peak.omega), 1e-12 * peak.omega));
                    peak = {trial, std::min(reached, peak.lowest)};
                    continue;
                }
            }
        }
        // an infimum at ω → 0 is approached, never passed
        const double trial = std::min(std::max(peak.omega + step, 0.5 * peak.omega), last);
        const double reached = objective(kind, loop.at(trial));
        if (reached < peak.lowest) {
            peak = {trial, reached};
            step *= 1.3;
        } else {
            step *= -0.5;
        }
    }
    return peak;
}

}  // namespace gainroom
