// Where |a S_ii + b| of coupled loops is largest, and how its height moves with the gains: between samples, by parabolas.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
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

    // Peaks of |slope S_ii + offset| above `least`: height, place and growth of its logarithm; or the first that is higher than `until` alone.
    std::vector<MovingMargin> above(const DirectedGains& gains, double least, double slope, double offset, bool moves, double until = kNever) {
        std::vector<MovingMargin> found;
        if (!samples_.ok()) return found;
        const auto& all = samples_.samples();
        const auto own = [&](std::size_t k, std::size_t i) { return slope * all[k]->sensitivity[i] + offset; };
        std::vector<std::pair<std::size_t, std::size_t>> peaks;  // sample and joint
        for (std::size_t k = 1; k + 1 < all.size(); k++)
            for (std::size_t i = 0; i < n_; i++) {
                const double square = std::norm(own(k, i));
                if (square > least * least && square >= std::norm(own(k - 1, i)) && square >= std::norm(own(k + 1, i))) peaks.emplace_back(k, i);
            }
        if (until < kNever)
            std::stable_sort(peaks.begin(), peaks.end(), [&](const auto& a, const auto& b) {
                return std::norm(own(a.first, a.second)) > std::norm(own(b.first, b.second));
            });
        const DirectedGains& seen = samples_.gains();
        const bool others = gains.kp != seen.kp || gains.kd != seen.kd || gains.ki != seen.ki;
        std::vector<std::vector<Complex>> there(others ? all.size() : 0);  // S_ii of these gains, of samples where they were asked for
        for (const auto& [k, i] : peaks) {
            double height[3], place[3];
            bool known = true;
            for (std::size_t j = 0; known && j < 3; j++) {
                const std::size_t at = k + j - 1;
                place[j] = all[at]->omega();
                if (others && there[at].empty()) there[at] = samples_.sensitivity(*all[at], gains);
                known = !others || !there[at].empty();
                if (known) height[j] = std::abs(others ? slope * there[at][i] + offset : own(at, i));
            }
            at_.begin(false, i);
            // A peak is no lower than any of its samples.
            if (!known || (others && !(height[1] > until) && !about_peak(gains, slope, offset, place, height))) continue;
            Complex value;
            bool wide = false;  // a parabola left more than half of the span, as on a peak that is steep on one side: the wider half is halved
            for (int round = 0; round < kParabolas && !(height[1] > until); round++) {
                const double width = place[2] - place[0];
                const double halfway = 0.5 * (place[1] + (place[2] - place[1] > place[1] - place[0] ? place[2] : place[0]));
                const double top = wide ? halfway : top_of_parabola(place, height);
                if (!at_.evaluate(top, gains, 0.0, value)) break;
                const double higher = std::abs(slope * at_.sensitivity() + offset);
                const bool level = !wide && std::fabs(higher - height[1]) <= kLevel * higher;
                const int to = higher >= height[1] ? (top > place[1] ? 0 : 2) : (top > place[1] ? 2 : 0);
                if (higher >= height[1]) {
                    place[to] = place[1];
                    height[to] = height[1];
                    place[1] = top;
                    height[1] = higher;
                } else {
                    place[to] = top;
                    height[to] = higher;
                }
                if (level) break;
                wide = !wide && place[2] - place[0] > 0.5 * width;
            }
            MovingMargin peak;
            peak.omega = place[1];
            peak.margin = height[1];
            peak.found = true;
            if (moves) {
                if (!at_.evaluate(place[1], gains, 0.0, value)) continue;
                const Complex top = slope * at_.sensitivity() + offset;
                peak.margin = std::abs(top);
                at_.grow_sensitivity();
                peak.moves.resize(2 * m_);
                for (std::size_t q = 0; q < 2 * m_; q++) peak.moves[q] = (over(slope * at_.growth()[q], top)).real();
            }
            found.push_back(peak);
            if (peak.margin > until) return {peak};
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
    static constexpr double kNever = std::numeric_limits<double>::infinity();
    static constexpr double kLevel = 1e-8;  // of a height: a parabola that adds less has come to the peak
    static constexpr double kClose = 0.05;  // peaks whose sampled heights are within it of the highest are polished
    static constexpr int kParabolas = 30, kWalk = 6;

    static double top_of_parabola(const double* place, const double* height) {
        const double before = (height[1] - height[0]) / std::max(place[1] - place[0], 1e-300);
        const double after = (height[2] - height[1]) / std::max(place[2] - place[1], 1e-300), bend = before - after;
        const double share = bend > 0 ? before / bend : 0.5;
        return std::clamp(0.5 * (place[0] + place[1]) + 0.5 * (place[2] - place[0]) * share, place[0], place[2]);
    }

    // Moves three places, with their heights, until a peak lies between them; false where none is near.
    bool about_peak(const DirectedGains& gains, double slope, double offset, double* place, double* height) {
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
            Complex value;
            if (!at_.evaluate(next, gains, 0.0, value)) return false;
            height[from] = std::abs(slope * at_.sensitivity() + offset);
        }
        return false;
    }

    LoopSamples& samples_;
    DirectedLoop& loop_;
    std::size_t n_, m_;
    CurveValue at_;
};

}  // namespace gainroom
