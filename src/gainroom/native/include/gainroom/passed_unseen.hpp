// Intervals between two samples in which a curve may cross a line twice more than the samples show.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <memory>
#include <vector>

#include "complex.hpp"
#include "loop_sample.hpp"

namespace gainroom {

using FourTimes = std::array<double, 4>;  // at the sample before an interval, at both its ends, and at the one after; NaN where there is none

// `away` from the line, with the sign of its side; `moved` over the interval, as a part of its size. With both ends on one side it may where it would pass the line by
// the other end, if it went on as it came, or went as it goes on; and beside a sample that is nearer than those beside it, where it moves further
// than it has room. With the ends on two sides it may where it would come kShort times as far behind the line.
inline bool may_pass_unseen(const FourTimes& omega, const FourTimes& away, double moved, double noise) {
    constexpr double kTurns = 1.0, kShort = 3.0;
    const bool same = away[1] * away[2] > 0;
    for (const std::size_t end : {1, 2}) {
        const double beyond = away[3 * end - 3], room = std::fabs(away[end]), other = std::fabs(away[3 - end]);
        if (!(room < kTurns && room > noise && other > noise)) continue;
        const double ratio = (omega[2] - omega[1]) / std::fabs(omega[end] - omega[3 * end - 3]);
        const double ahead = std::copysign(1.0, away[end]) * (away[end] + (away[end] - beyond) * ratio);  // < 0 behind the line
        const bool turns = same && beyond * away[end] > 0 && room <= std::min(std::fabs(beyond), other);
        if ((turns && moved > room) || ahead < (same ? 0.0 : -kShort * other)) return true;
    }
    return false;
}

// A scalar curve at one frequency.
struct CurvePlace {
    double omega;
    Complex value;
};

// Intervals of a curve that is larger than `faint`, from the k-th place to the next, on which it may pass the negative real axis unseen, or moves by a
// quarter of itself near it: left of where it crosses for sure.
inline std::vector<std::size_t> passed_unseen(const std::vector<CurvePlace>& places, double faint) {
    constexpr double kMove = 0.25, kWithin = 0.5, kNoise = 1e-10, kClosest = 1e-7, kUnknown = std::numeric_limits<double>::quiet_NaN();
    const auto move = [&](std::size_t k) { return size_of_any(places[k + 1].value - places[k].value); };
    const auto larger = [&](std::size_t k) { return std::max(size_of_any(places[k].value), size_of_any(places[k + 1].value)); };
    double surely = 0.0;
    for (std::size_t k = 0; k + 1 < places.size(); k++) {
        const Complex start = places[k].value, end = places[k + 1].value;
        const bool crosses = (start.imag() > 0) != (end.imag() > 0) && std::max(start.real(), end.real()) < 0;
        if (crosses && move(k) <= kMove * larger(k)) surely = std::max(surely, -std::max(start.real(), end.real()));
    }
    std::vector<std::size_t> found;
    FourTimes omega, away;
    for (std::size_t k = 0; k + 1 < places.size(); k++) {
        const Complex start = places[k].value, end = places[k + 1].value;
        const double size = larger(k);
        if (!(std::min(start.real(), end.real()) < 0 && size > faint) || places[k + 1].omega - places[k].omega <= kClosest * places[k + 1].omega) continue;
        const bool near = std::min(std::fabs(start.imag()), std::fabs(end.imag())) < size;
        bool rough = near && move(k) > kMove * size && size > kWithin * surely;
        if (!rough && start.real() < 0 && end.real() < 0 && size > surely) {
            for (std::size_t j = 0; j < 4; j++) {
                const bool known = k + j >= 1 && k + j <= places.size();
                omega[j] = known ? places[k + j - 1].omega : kUnknown;
                away[j] = known ? std::arg(-places[k + j - 1].value) : kUnknown;
            }
            rough = may_pass_unseen(omega, away, move(k) / std::max(1e-300, std::min(size_of_any(start), size_of_any(end))), kNoise);
        }
        if (rough) found.push_back(k);
    }
    return found;
}

// Intervals between samples, from the k-th to the next, on which a locus or a return ratio may so pass the unit circle with less than a phase, or
// the negative real axis with less than a |ln g|. Loci are known, and paired, where `followed(k)`.
template <typename Followed>
std::vector<std::size_t> passed_unseen(const std::vector<std::unique_ptr<LoopSample>>& samples, double factor, double phase, Followed followed) {
    constexpr double kNoise = 1e-10, kUnknown = std::numeric_limits<double>::quiet_NaN();
    const auto side = [](double angle) { return angle > 0 ? angle - kPi : angle + kPi; };  // of −λ
    std::vector<std::size_t> found;
    FourTimes omega, sizes, sides;
    const auto may_pass = [&](double moved, double noise) {
        const auto within = [](const FourTimes& along, double reach) { return std::min(std::fabs(along[1]), std::fabs(along[2])) < reach; };
        return (within(sides, phase) && may_pass_unseen(omega, sizes, moved, noise)) || (within(sizes, factor) && may_pass_unseen(omega, sides, moved, noise));
    };
    const std::size_t count = samples.size();
    const double far = std::exp(2 * std::max(1.0, factor));  // and the inverse of it: squares of what is too large or too small to matter
    for (std::size_t k = 0; k + 1 < count; k++) {
        for (std::size_t j = 0; j < 4; j++) omega[j] = k + j >= 1 && k + j <= count ? samples[k + j - 1]->omega() : kUnknown;
        const LoopSample &low = *samples[k], &high = *samples[k + 1];
        bool rough = false;
        if (followed(k)) {
            const bool before = k > 0 && followed(k - 1), after = k + 2 < count && followed(k + 1);
            const double most = std::max(low.loci.largest(), high.loci.largest());
            for (std::size_t i = 0; !rough && i < low.pairs.size(); i++) {
                const std::size_t j = low.pairs[i];
                const double least = std::min(low.loci.sizes[i], high.loci.sizes[j]);
                if (std::min(std::fabs(low.loci.sizes[i]), std::fabs(high.loci.sizes[j])) > std::max(1.0, factor)) continue;
                sizes = sides = {kUnknown, kUnknown, kUnknown, kUnknown};
                const auto set = [&](std::size_t place, const Loci& loci, std::size_t which) {
                    sizes[place] = loci.sizes[which];
                    sides[place] = side(loci.angles[which]);
                };
                if (before) {
                    const std::vector<std::size_t>& pairs = samples[k - 1]->pairs;
                    set(0, samples[k - 1]->loci, static_cast<std::size_t>(std::find(pairs.begin(), pairs.end(), i) - pairs.begin()));
                }
                set(1, low.loci, i);
                set(2, high.loci, j);
                if (after) set(3, samples[k + 2]->loci, high.pairs[j]);
                const double size = std::exp(least);
                rough = may_pass(size_of_any(high.loci.values[j] - low.loci.values[i]) / size, kNoise * most / size);
            }
        }
        for (std::size_t i = 0; !rough && i < low.sensitivity.size(); i++) {
            const auto ratio = [&](std::size_t at) { return over(1.0, samples[at]->sensitivity[i]) - 1.0; };
            const Complex start = ratio(k), end = ratio(k + 1);
            const double smaller = std::min(std::norm(start), std::norm(end)), larger = std::max(std::norm(start), std::norm(end));
            if (!(smaller < far && larger * far > 1) || (std::max(1.0, phase) < 0.5 * kPi && start.real() > 0 && end.real() > 0)) continue;
            for (std::size_t j = 0; j < 4; j++) {
                const Complex value = j == 1 ? start : j == 2 ? end : std::isnan(omega[j]) ? Complex(kUnknown) : ratio(k + j - 1);
                sizes[j] = 0.5 * std::log(std::norm(value));
                sides[j] = std::arg(-value);
            }
            rough = may_pass(size_of_any(end - start) / std::sqrt(smaller), kNoise);
        }
        if (rough) found.push_back(k);
    }
    return found;
}

}  // namespace gainroom
