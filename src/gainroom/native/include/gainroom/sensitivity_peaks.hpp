// Where |a S_ii + b| of coupled loops is largest, and how its height moves with the gains: between samples, by parabolas.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "curve_value.hpp"
#include "loop_samples.hpp"

namespace gainroom {

// A margin, and how it moves with ln of stiffness and of damping of every direction (2, m).
struct MovingMargin {
    double margin = 0.0, omega = 0.0;
    Complex value;  // of the curve there
    std::vector<double> moves;
    std::vector<double> shifts;  // of a crossing: how ω moves with them
    bool found = false;
};

class SensitivityPeaks {
public:
    explicit SensitivityPeaks(LoopSamples& samples) : samples_(samples), loop_(samples.loop()), n_(loop_.size()), m_(loop_.directions), at_(loop_) {}

    // Peaks of |slope S_ii + offset| above `least`: height, place and growth of its logarithm.
    std::vector<MovingMargin> above(const DirectedGains& gains, double least, double slope, double offset, bool moves) {
        std::vector<MovingMargin> found;
        if (!samples_.ok()) return found;
        const auto& all = samples_.samples();
        const auto own = [&](std::size_t k, std::size_t i) { return slope * all[k]->sensitivity[i] + offset; };
        const DirectedGains& seen = samples_.gains();
        const bool others = gains.kp != seen.kp || gains.kd != seen.kd || gains.ki != seen.ki;
        for (std::size_t k = 1; k + 1 < all.size(); k++)
            for (std::size_t i = 0; i < n_; i++) {
                const double square = std::norm(own(k, i));
                if (!(square > least * least && square >= std::norm(own(k - 1, i)) && square >= std::norm(own(k + 1, i)))) continue;
                double height[3] = {std::abs(own(k - 1, i)), std::abs(own(k, i)), std::abs(own(k + 1, i))};
                double place[3] = {all[k - 1]->omega(), all[k]->omega(), all[k + 1]->omega()};
                at_.begin(false, i);
                Complex value;
                if (others && !about_peak(gains, slope, offset, place, height)) continue;
                for (int round = 0; round < kParabolas; round++) {
                    const double top = top_of_parabola(place, height);
                    if (!at_.evaluate(top, gains, 0.0, value)) break;
                    const double there = std::abs(slope * at_.sensitivity() + offset);
                    const int to = there >= height[1] ? (top > place[1] ? 0 : 2) : (top > place[1] ? 2 : 0);
                    if (there >= height[1]) {
                        place[to] = place[1];
                        height[to] = height[1];
                        place[1] = top;
                        height[1] = there;
                    } else {
                        place[to] = top;
                        height[to] = there;
                    }
                }
                MovingMargin peak;
                peak.omega = place[1];
                peak.margin = height[1];
                peak.found = true;
                if (moves) {
                    if (!at_.evaluate(place[1], gains, 0.0, value)) continue;
                    const Complex there = slope * at_.sensitivity() + offset;
                    peak.margin = std::abs(there);
                    at_.grow_sensitivity();
                    peak.moves.resize(2 * m_);
                    for (std::size_t q = 0; q < 2 * m_; q++) peak.moves[q] = (over(slope * at_.growth()[q], there)).real();
                }
                found.push_back(peak);
            }
        return found;
    }

    // The largest |slope S_ii + offset|, and where.
    MovingMargin highest(double slope, double offset) {
        MovingMargin top;
        double most = 0.0;
        for (const auto& sample : samples_.samples())
            for (const Complex& value : sample->sensitivity)
                if (const double square = std::norm(slope * value + offset); square > most) {
                    most = square;
                    top.margin = std::sqrt(square);
                    top.omega = sample->omega();
                }
        for (const MovingMargin& one : above(samples_.gains(), (1 - kClose) * top.margin, slope, offset, false))
            if (one.margin > top.margin) top = one;
        return top;
    }

private:
    static constexpr double kClose = 0.05;  // peaks whose sampled heights are within it of the highest are polished
    static constexpr int kParabolas = 4, kWalk = 6;

    static double top_of_parabola(const double* place, const double* height) {
        const double before = (height[1] - height[0]) / std::max(place[1] - place[0], 1e-300);
        const double after = (height[2] - height[1]) / std::max(place[2] - place[1], 1e-300), bend = before - after;
        const double share = bend > 0 ? before / bend : 0.5;
        return std::clamp(0.5 * (place[0] + place[1]) + 0.5 * (place[2] - place[0]) * share, place[0], place[2]);
    }

    // Three places about a peak, from where it was with other gains; false where it is not found near there.
    bool about_peak(const DirectedGains& gains, double slope, double offset, double* place, double* height) {
        const auto fill = [&](int k) {
            Complex value;
            const bool found = at_.evaluate(place[k], gains, 0.0, value);
            height[k] = std::abs(slope * at_.sensitivity() + offset);
            return found;
        };
        for (int k = 0; k < 3; k++)
            if (!fill(k)) return false;
        for (int round = 0; round < kWalk; round++) {
            const int from = height[0] > height[1] ? 0 : height[2] > height[1] ? 2 : 1;
            if (from == 1) return true;
            const double next = place[from] + 1.5 * (place[from] - place[1]);
            if (!(next > 0 && next <= loop_.last)) return false;
            place[2 - from] = place[1];
            height[2 - from] = height[1];
            place[1] = place[from];
            height[1] = height[from];
            place[from] = next;
            if (!fill(from)) return false;
        }
        return false;
    }

    LoopSamples& samples_;
    DirectedLoop& loop_;
    std::size_t n_, m_;
    CurveValue at_;
};

}  // namespace gainroom
