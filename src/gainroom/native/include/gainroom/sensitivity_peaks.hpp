// Peaks of |a S_ii + b| of coupled loops over frequency, and the derivatives of their height by the gains.
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
    std::size_t which = 0;       // locus, or joint
    bool found = false;
};

class SensitivityPeaks {
public:
    explicit SensitivityPeaks(LoopSamples& samples) : samples_(samples), loop_(samples.loop()), n_(loop_.loops()), m_(loop_.directions), at_(loop_) {}

    // Peaks of |slope S_ii + offset| above `least`: height, place and growth of its logarithm; or the first that is higher than `until` alone.
    std::vector<MovingMargin> above(const DirectedGains& gains, double least, double slope, double offset, bool moves, double until = kNever) {
        return above(gains, std::vector<double>(n_, least), slope, offset, moves, until);
    }

    // Peaks of each joint above its `least` (n).
    std::vector<MovingMargin> above(const DirectedGains& gains, const std::vector<double>& least, double slope, double offset, bool moves,
                                    double until = kNever) {
        std::vector<MovingMargin> found;
        if (!samples_.ok()) return found;
        const auto& all = samples_.samples();
        const auto own = [&](std::size_t k, std::size_t i) { return slope * all[k]->sensitivity[i] + offset; };
        std::vector<double> squares(all.size() * n_);  // of heights
        for (std::size_t k = 0; k < all.size(); k++)
            for (std::size_t i = 0; i < n_; i++) squares[k * n_ + i] = std::norm(own(k, i));
        std::vector<std::pair<std::size_t, std::size_t>> peaks;  // sample and joint
        for (std::size_t k = 1; k + 1 < all.size(); k++)
            for (std::size_t i = 0; i < n_; i++) {
                const double* square = &squares[k * n_ + i];
                if (*square > least[i] * least[i] && *square >= *(square - n_) && *square >= *(square + n_)) peaks.emplace_back(k, i);
            }
        if (until < kNever)
            std::stable_sort(peaks.begin(), peaks.end(), [&](const auto& a, const auto& b) {
                return std::norm(own(a.first, a.second)) > std::norm(own(b.first, b.second));
            });
        const DirectedGains& seen = samples_.gains();
        const bool others = gains.kp != seen.kp || gains.kd != seen.kd || gains.ki != seen.ki;
        std::vector<std::vector<Complex>> there(others ? all.size() : 0);  // S_ii of these gains, of samples where they were asked for
        for (const auto& [k, i] : peaks) {
            double place[3];
            Complex value[3];  // slope S_ii + offset there
            bool known = true;
            for (std::size_t j = 0; known && j < 3; j++) {
                const std::size_t at = k + j - 1;
                place[j] = all[at]->omega();
                if (others && there[at].empty()) there[at] = samples_.sensitivity(*all[at], gains);
                known = !others || !there[at].empty();
                if (known) value[j] = others ? slope * there[at][i] + offset : own(at, i);
            }
            const auto evaluate = [&, joint = i](double omega, Complex& found) {
                at_.begin(false, joint);
                Complex ratio;
                if (!at_.evaluate(omega, gains, 0.0, ratio)) return false;
                found = slope * at_.sensitivity() + offset;
                return true;
            };
            // A peak is no lower than any of its samples.
            if (!known || (others && !(size_of_any(value[1]) > until) && !about_peak(evaluate, place, value))) continue;
            const double last = climb(evaluate, place, value, until, moves ? kUseful : kLevel);
            MovingMargin peak;
            peak.omega = place[1];
            peak.margin = size_of_any(value[1]);
            peak.which = i;
            peak.found = true;
            if (moves) {
                if (last != place[1] && !evaluate(place[1], value[1])) continue;
                at_.grow_sensitivity();
                peak.moves.resize(2 * m_);
                for (std::size_t q = 0; q < 2 * m_; q++) peak.moves[q] = (over(slope * at_.growth()[q], value[1])).real();
            }
            found.push_back(peak);
            if (peak.margin > until) return {peak};
        }
        return found;
    }

    // The largest |slope S_ii + offset|, and where.
    MovingMargin highest(double slope, double offset) {
        const std::vector<MovingMargin> sampled = tops(slope, offset);
        MovingMargin top = *std::max_element(sampled.begin(), sampled.end(), lower);
        for (const MovingMargin& one : above(samples_.gains(), (1 - kClose) * top.margin, slope, offset, false))
            if (one.margin > top.margin) top = one;
        return top;
    }

    // The largest |a S_ii + b| of each joint (n).
    std::vector<MovingMargin> highest_of_each(double slope, double offset) {
        std::vector<MovingMargin> found = tops(slope, offset);
        std::vector<double> least;
        for (const MovingMargin& one : found) least.push_back((1 - kClose) * one.margin);
        for (const MovingMargin& one : above(samples_.gains(), least, slope, offset, false))
            if (one.margin > found[one.which].margin) found[one.which] = one;
        return found;
    }

private:
    static bool lower(const MovingMargin& a, const MovingMargin& b) { return a.margin < b.margin; }

    // The highest samples of each joint (n).
    std::vector<MovingMargin> tops(double slope, double offset) const {
        std::vector<MovingMargin> found(n_);
        for (const auto& sample : samples_.samples())
            for (std::size_t i = 0; i < sample->sensitivity.size(); i++)
                if (const double height = size_of_any(slope * sample->sensitivity[i] + offset); height > found[i].margin) {
                    found[i].margin = height;
                    found[i].omega = sample->omega();
                }
        return found;
    }

    static constexpr double kNever = std::numeric_limits<double>::infinity();
    // Of a height: a step that adds less, or was foreseen as well, has come to the peak; to a search for gains sooner.
    static constexpr double kLevel = 1e-8, kUseful = 1e-6;
    static constexpr double kClose = 0.05;  // peaks whose sampled heights are within it of the highest are polished
    static constexpr int kSteps = 30, kWalk = 6;

    // To the top of a peak between three places, the middle one highest. About a resonance S_ii is as good as a + b/(s − p): the one through all
    // three has its top where the next place is. Where that leaves more than half of the span the wider half is halved. Returns the last place.
    template <typename Evaluate>
    static double climb(Evaluate evaluate, double* place, Complex* value, double until, double little) {
        double top = 0.0;
        bool wide = false;
        for (int round = 0; round < kSteps && !(size_of_any(value[1]) > until); round++) {
            const double width = place[2] - place[0];
            const double halfway = 0.5 * (place[1] + (place[2] - place[1] > place[1] - place[0] ? place[2] : place[0]));
            double expected = 0.0;
            top = wide ? halfway : top_between(place, value, expected);
            Complex there;
            if (top == place[1] || !evaluate(top, there)) break;
            const double height = size_of_any(there), before = size_of_any(value[1]);
            const bool level = !wide && std::min(std::fabs(height - before), std::fabs(height - expected)) <= little * height;
            const bool higher = height >= before, after = top > place[1];
            const int to = higher == after ? 0 : 2;
            place[to] = higher ? place[1] : top;
            value[to] = higher ? value[1] : there;
            if (higher) {
                place[1] = top;
                value[1] = there;
            }
            if (level) break;
            wide = !wide && place[2] - place[0] > 0.5 * width;
        }
        return top;
    }

    // Where |(v + b t)/(1 + c t)|, t from the middle place, through three values is highest between the outer ones, and how high.
    static double top_between(const double* place, const Complex* value, double& height) {
        const double before = place[0] - place[1], after = place[2] - place[1];
        const Complex v = value[1], first = (value[0] - v) / before, second = (value[2] - v) / after;
        const Complex c = over(second - first, value[0] - value[2]), b = first + times(c, value[0]);
        const double vv = std::norm(v), vb = (std::conj(v) * b).real(), bb = std::norm(b), cr = c.real(), cc = std::norm(c);
        const double p = bb * cr - vb * cc, q = bb - vv * cc, r = vb - vv * cr;  // the slope of the square is 0 where p t² + q t + r is
        const double root = std::sqrt(std::max(0.0, q * q - 4 * p * r)), half = -0.5 * (q + std::copysign(root, q));
        double best = std::fabs(before) < after ? 0.5 * after : 0.5 * before;
        height = 0.0;
        for (const double t : {half != 0 ? r / half : 0.0, p != 0 ? half / p : 0.0}) {
            const double own = size_of_any(over(v + b * t, 1.0 + c * t));
            if (!(t >= before && t <= after) || !(own > height)) continue;
            best = t;
            height = own;
        }
        return place[1] + best;
    }

    // Moves three places, with their values, until a peak lies between them; false where none is near.
    template <typename Evaluate>
    bool about_peak(Evaluate evaluate, double* place, Complex* value) {
        for (int round = 0; round < kWalk; round++) {
            const int from = std::norm(value[0]) > std::norm(value[1]) ? 0 : std::norm(value[2]) > std::norm(value[1]) ? 2 : 1;
            if (from == 1) return true;
            const double next = place[from] + 1.5 * (place[from] - place[1]);
            if (!(next > 0 && next <= loop_.last)) return false;
            place[2 - from] = place[1];
            value[2 - from] = value[1];
            place[1] = place[from];
            value[1] = value[from];
            place[from] = next;
            if (!evaluate(next, value[from])) return false;
        }
        return false;
    }

    LoopSamples& samples_;
    DirectedLoop& loop_;
    std::size_t n_, m_;
    CurveValue at_;
};

}  // namespace gainroom
