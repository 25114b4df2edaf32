// The extra delay that puts a root of a sampled loop of one joint on the boundary of stability, confirmed on both sides of it.
// (Of coupled loops: analysis/boundary.py.)
//
// A fraction of a tick of delay in front of a hold is nearly, not quite, a phase ωT. So the first of the gain crossings, and those that
// come about as soon, are followed with the plant sampled anew for each delay. Where the count of roots does not confirm the first of
// them, delays are tried one after the other, in steps that are short beside a tick and beside that first one, as a loop may be stable
// again with more delay; and the first unstable one is halved.
#pragma once

#include "sampling.hpp"
#include "scan.hpp"

namespace gainroom {

constexpr double kDelayNudge = 1e-7;   // relative; the delay margin is confirmed on both sides of it,
constexpr double kLeastAngle = 1e-10;  // or this far in phase [rad] where it is next to nothing

struct SplitDelay {
    double whole, fraction;  // ticks
};

// Within rounding of a whole number of ticks nothing is left: 4.0 ms / 0.5 ms is not a whole number in floating point.
inline SplitDelay split_delay(double delay, double sample_time) {
    constexpr double kSameTick = 1e-12;  // it moves a phase by less than 4e-12 rad
    const double ticks = delay / sample_time, nearest = std::nearbyint(ticks);
    if (std::fabs(ticks - nearest) <= kSameTick + 1e-15 * ticks) return {nearest, 0.0};  // roundings: delay, sample time, quotient
    return {std::floor(ticks), ticks - std::floor(ticks)};
}

enum class Found { nothing, confirmed, halved, endless, failed };

struct DelayMargin {
    Found found;
    double extra, omega;
};

class DelayedLoop {
   public:
    // `plant` from torque command to measured position, continuous, behind `delay` [s]; `control` in v with all gains; the poles of L that
    // grow.
    DelayedLoop(const Sampler& plant, const Factors& control, double delay, double sample_time, int unstable_poles)
        : plant_(plant), control_(control), delay_(delay), step_(sample_time), unstable_poles_(unstable_poles),
          failed_(!(std::fabs(delay) <= kMostTicks * sample_time)) {}

    // `crossings`: the delay margin of each gain crossing, as a phase, and its ω; by delay.
    DelayMargin margin(const std::vector<std::array<double, 2>>& crossings) {
        double extra = kInfinite, omega = std::numeric_limits<double>::quiet_NaN();
        if (failed_) return {Found::failed, extra, omega};
        for (std::size_t k = 0; k < std::min<std::size_t>(crossings.size(), kMostFollowed); k++) {
            if (!(crossings[k][0] <= 1.02 * crossings[0][0] + 0.1 * step_)) break;
            double later = crossings[k][0], place = crossings[k][1];
            if (followed(later, place) && later < extra) extra = later, omega = place;
        }
        const bool finite = std::isfinite(extra);
        if (finite && confirmed(extra, kDelayNudge * extra + kLeastAngle / omega)) return {Found::confirmed, extra, omega};
        const Response now = response(0.0);
        const bool latest = size_of_any(now.at(kPi / step_)) > 1;  // within a tick L(−1) then comes to −1 from 1 or more
        if (failed_) return {Found::failed, extra, omega};
        if (!finite && crossings.empty() && !latest) return {Found::nothing, extra, omega};
        return halved(crossings.empty() ? step_ : std::min(crossings[0][0], step_));
    }

   private:
    static constexpr std::size_t kMostFollowed = 4;
    static constexpr int kMostSteps = 40, kMostTries = 64, kMostDoublings = 40, kMostHalvings = 120, kMostNewton = 30;
    static constexpr double kPace = 0.125;  // of the least extra delay that matters: from one try to the next
    static constexpr double kMostTicks = 1e15;  // of delay: beyond, a double holds no fraction of a tick

    const Sampler& plant_;
    const Factors& control_;
    double delay_, step_;
    int unstable_poles_;
    bool failed_;

    // With `extra` more delay, less than a tick.
    Response response(double extra) {
        const SplitDelay split = split_delay(delay_ + extra, step_);
        Factors loop = plant_.at(split.fraction);
        failed_ = failed_ || loop.poles.empty();
        loop.zeros.insert(loop.zeros.end(), control_.zeros.begin(), control_.zeros.end());
        loop.poles.insert(loop.poles.end(), control_.poles.begin(), control_.poles.end());
        for (auto zero = loop.zeros.begin(); (zero = std::find(loop.zeros.begin(), loop.zeros.end(), 0.0)) != loop.zeros.end();) {
            const auto pole = std::find(loop.poles.begin(), loop.poles.end(), 0.0);
            if (pole == loop.poles.end()) break;
            loop.zeros.erase(zero);
            loop.poles.erase(pole);
        }
        return {loop.zeros.data(), loop.zeros.size(), loop.poles.data(), loop.poles.size(),
                loop.gain * control_.gain, split.whole * step_, step_};
    }

    double whole_ticks(double extra) const { return std::floor(extra / step_); }

    // Moves `omega` to the gain crossing nearby with `extra` more delay and `extra` to where its phase margin ends; gains about four
    // digits a step, near resonances less.
    bool followed(double& extra, double& omega) {
        if (!std::isfinite(extra)) return false;
        for (int step = 0; step < kMostSteps && !failed_; step++) {
            const double ticks = whole_ticks(extra);
            const Response later = response(extra - ticks * step_);
            if (!at_gain_crossing(later, omega)) return false;
            const double left = wrapped(std::arg(-later.at(omega)) - omega * ticks * step_) / omega;
            if (!(extra + left >= 0)) return false;
            extra += left;
            if (std::fabs(left) <= 1e-12 * extra) return true;
        }
        return false;
    }

    // Newton on log|L| over log ω from nearby.
    static bool at_gain_crossing(const Response& loop, double& omega) {
        std::vector<Slope> terms(loop.roots.size());
        const double start = omega;
        for (int step = 0; step < kMostNewton; step++) {
            const Complex value = loop.at(omega, terms.data());
            double slope = 0.0;
            for (const Slope& term : terms) slope += term.size;
            const double move = log_size(value) / slope;
            if (!(std::fabs(move) <= 0.1 * start)) return false;
            omega -= move;
            if (!(std::fabs(omega - start) <= 0.1 * start)) return false;
            if (std::fabs(move) <= 1e-15 * omega) return true;
        }
        return true;
    }

    bool confirmed(double extra, double nudge) { return is_stable(extra - nudge) && !is_stable(extra + nudge); }

    // Whether the loop is stable with `extra` more delay [s].
    //
    // Whole ticks only turn L: by ωT_s each, so that a pair of roots comes out where |L| falls through 1 and arg L passes an odd multiple of
    // π, and goes in where |L| rises; where |L| > 1 at z = −1, each tick brings one root more. Thousands of ticks cost no more than one.
    bool is_stable(double extra) {
        const double ticks = whole_ticks(extra);
        const Response later = response(extra - ticks * step_);
        if (failed_) return false;
        const Scan scan = gainroom::scan(later, false);
        failed_ = std::isnan(scan.half_turns);
        bool outside = size_of_any(later.at(kPi / step_)) > 1;
        double unstable = unstable_roots(scan, unstable_poles_) + (outside ? ticks : 0.0);
        for (std::size_t k = scan.gains.size(); k-- > 0;) {
            const double phase = scan.gains[k].phase, later_phase = phase - scan.gains[k].omega * ticks * step_;
            const double turns = std::floor((phase - kPi) / (2 * kPi)) - std::floor((later_phase - kPi) / (2 * kPi));
            unstable += 2 * turns * (outside ? -1 : 1);
            outside = !outside;
        }
        return unstable == 0;
    }

    // By bisection below the first unstable delay of those tried, the first of them a share of `scale`.
    DelayMargin halved(double scale) {
        double stable = 0.0, unstable = kPace * scale;
        for (int k = 0; is_stable(unstable); k++) {
            if (k == kMostTries + kMostDoublings) return {Found::endless, unstable, 0.0};
            stable = unstable;
            unstable = k < kMostTries ? (k + 2) * kPace * scale : 2 * unstable;
        }
        for (int halving = 0; halving < kMostHalvings && unstable - stable > kDelayNudge * unstable && !failed_; halving++) {
            const double middle = 0.5 * (stable + unstable);
            (is_stable(middle) ? stable : unstable) = middle;
        }
        const double ticks = whole_ticks(stable);
        const Response later = response(stable - ticks * step_);
        double nearest = kInfinite, omega = std::numeric_limits<double>::quiet_NaN();
        if (!failed_)
            for (const GainCrossing& crossing : gainroom::scan(later, false).gains) {
                const double margin = std::fabs(wrapped(crossing.phase - kPi - crossing.omega * ticks * step_));
                if (margin < nearest) nearest = margin, omega = crossing.omega;
            }
        return {failed_ ? Found::failed : Found::halved, stable, omega};
    }
};

}  // namespace gainroom
