// Interface of a closed loop whose gains all carry one factor g, as the tracker needs it: joint_loop.hpp and task_loop.hpp give it.
//
// A posture is a row of numbers, and a mixture of two postures is one on the way between them.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>

#include "block.hpp"
#include "complex.hpp"

namespace gainroom {

// A gain factor g and a frequency ω at which the closed loop has a root jω, followed as the posture changes.
struct TrackedCrossing {
    explicit TrackedCrossing(std::size_t size) : mode(size), before(size), beside(2 * size) {}

    double omega = 0.0, gain = 0.0;
    double rising = 0.0;   // > 0: a pair of roots becomes unstable as the factor rises past `gain`
    double spread = 1.0;   // how much the gain moves at most: |d ln g| <= spread · (change of the posture)
    double speed = 0.0;    // how much it has moved lately: |d ln g| along the path (tracker.hpp)
    double seen_at = 0.0;  // the path at which it was right
    long looked_at = 0;    // the tick at which it was last followed, or seen to be above the lowest
    bool converged = false;
    std::uint64_t factored = 0;  // which factors of the CrossingFollower are its own, if they are still there
    double omega_before = 0.0, gain_before = 0.0, stride = 0.0;  // where it was one step before, and the path of that step; 0: not known
    Vector<Complex> mode, before;
    bool clear = false;  // nothing beside it is unstable at factors up to the lowest crossing's, see `clear_below`
    double clear_at = 0.0, clear_for = 0.0;  // the path at which that was seen, and for how much more of it that is taken to hold
    long clear_tick = 0;                                     // the tick at which it was
    bool clear_as_lowest = false, clear_anew = false;        // whether it was the lowest then; whether with modes that were not known before
    bool has_beside = false;
    Vector<Complex> beside;  // other modes about its frequency, where they are known

    // A start at a place, with a mode that is to be filled in.
    void begin(double at, double factor) {
        omega = omega_before = at;
        gain = gain_before = factor;
        factored = 0;
        stride = 0.0;
        clear = has_beside = false;
    }

    // Where it will be after `ahead` more of the path, if it goes on as before.
    void extrapolate(double ahead, double& omega_then, double& gain_then, Vector<Complex>& mode_then) const {
        const double share = stride > 0.0 && ahead < 3.0 * stride ? ahead / stride : 0.0;
        omega_then = omega + share * (omega - omega_before);
        gain_then = gain + share * (gain - gain_before);
        for (std::size_t i = 0; i < mode.size(); i++) mode_then[i] = mode[i] + share * (mode[i] - before[i]);
    }

    // To there.
    void predict(double ahead) {
        extrapolate(ahead, omega_before, gain_before, before);
        std::swap(omega, omega_before);
        std::swap(gain, gain_before);
        mode.swap(before);
        stride = ahead;
    }

    bool normalize() {
        double size = 0.0;
        for (const Complex& x : mode) size += std::norm(x);
        if (!(size > 0.0) || !std::isfinite(size)) return false;
        size = 1.0 / std::sqrt(size);
        for (Complex& x : mode) x *= size;
        return true;
    }
};

// One frequency of a count: the phase there, and the slope of the function's logarithm along ω; see TrackedLoop.
struct Slice {
    double omega = 0.0, phase = 0.0;
    Complex slope;
};

class TrackedLoop {
public:
    static constexpr std::size_t kMostAtOnce = 4;
    static constexpr double kWidest = 0.15;  // of ω, a step of a count

    virtual ~TrackedLoop() = default;

    virtual std::size_t posture_size() const = 0;
    virtual std::size_t mode_size() const = 0;
    virtual std::size_t channels() const = 0;  // how many crossings at one frequency there can be
    virtual double sample_time() const = 0;    // 0: continuous
    // Crossings are followed from this frequency on [rad/s]. Below it nothing crosses; or, from `slowest` on, a count of its own says so. 0: that is not known of any.
    virtual double lowest() const = 0;
    virtual double slowest() const { return lowest(); }
    // Slices of a count that fit in an ordinary tick, and in one where there is no certificate.
    virtual double usual_slices() const = 0;
    virtual double urgent_slices() const = 0;
    virtual double prepared_slices() const { return 3.0 * usual_slices(); }  // for another contact state

    // How far above the lowest crossing, as a share of it, the unstable roots are counted at most, and up to which factor of it others are followed.
    virtual double farthest() const { return 0.2; }
    virtual double followed() const { return 1.4; }
    // How fast a crossing that is not known is taken to move at least, |d ln g| along the path.
    virtual double slowest_speed() const { return 0.5; }

    // How far a robot has moved from the posture `before` to `now`; not finite where one of them is none.
    virtual double distance(const double* before, const double* now) = 0;

    // Follows `crossing` to a posture; `work` is counted in slices. True where it has converged: `converged` says so too. Where it need only be
    // `rough`, true as soon as its mode is within that, and gain and frequency within the square.
    virtual bool follow(const double* posture, TrackedCrossing& crossing, int steps, double& work, bool rough) = 0;

    // A gain that `crossing`, followed `ahead` of the path before, is above at a posture; NaN where that takes to follow it.
    virtual double least_gain(const double*, const TrackedCrossing&, double, double&) { return std::numeric_limits<double>::quiet_NaN(); }

    // Whether no root beside the crossing's own, which has just been followed, is unstable at factors a little below it and not above the lowest
    // crossing's; asked of those up to `beside` above that, as a share of it. After a no: starts for the crossing at which one becomes so (0), and
    // for that at which it is stable again (1).
    virtual double beside() const { return 0.0; }
    virtual bool clear_below(const double*, TrackedCrossing&, const TrackedCrossing& /*lowest*/, double& /*work*/) { return true; }
    virtual bool start_below(int, TrackedCrossing&) { return false; }

    // At jω and a factor: the phase up to turns of a function of the closed loop that has its unstable roots and no others, and, where
    // asked for, the slope of its logarithm along ω.
    virtual double phase(const double* posture, double omega, double gain, Complex* slope) = 0;
    // The same at several frequencies, up to `at_once`, and what that costs, in slices. `phase` was at none of them then.
    virtual double phases(const double* posture, double gain, Slice* slices, std::size_t count) {
        for (std::size_t k = 0; k < count; k++) slices[k].phase = phase(posture, slices[k].omega, gain, &slices[k].slope);
        return double(count);
    }
    virtual std::size_t at_once() const { return 1; }  // at most kMostAtOnce
    // That phase where `phase` was last, not only up to turns: at `lowest` and `slowest`, anywhere at the factor 0, and where nothing crosses.
    // NaN where it is not known.
    virtual double whole_phase() = 0;
    // The same two at another factor, where they cost less than a slice, and what: then pairs are counted at lower factors as well.
    virtual double phase_at(double) { return 0.0; }
    virtual double whole_phase_at(double) { return 0.0; }
    virtual double lower_cost() const { return 1.0; }
    // Up to which frequency from `omega` on it is proved at once that nothing crosses below a factor; not above `lowest`. `omega`: not even there.
    virtual double clear_until(const double*, double omega, double) { return omega; }
    // Up to which factor nothing crosses where `phase` was last, and nothing is near; of the frequencies below `lowest`.
    virtual double clear_gain() { return std::numeric_limits<double>::infinity(); }
    // Whether at `slowest` all that turns the phase at a factor lies where it does in a loop that is stable at low factors.
    virtual bool leads_slowly(const double*, double) { return true; }
    // How far gains act on each other one way, from 0 to √2: a crossing may then come from far away within hardly any motion.
    virtual double one_sided(const double*) { return 0.0; }
    // True if the loop has the plant's poles.
    virtual bool has_poles() const { return false; }
    // Above every resonance of the plant [rad/s].
    virtual double resonance(const double* posture) const = 0;
    // From there on control does next to nothing in continuous time [rad/s]; not below `from`.
    virtual double top(const double* posture, double gain, double from) = 0;
    // Up to there, the share of ω beyond which one could hide; at most kWidest.
    virtual double resolution(double omega) const = 0;
};

}  // namespace gainroom
