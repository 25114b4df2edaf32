// Counts of unstable roots below the lowest known crossing, where there must be none: what no crossing that is followed leads to is found there.
//
// They take the time that a robot at rest leaves, or one that hardly moves.
#pragma once

#include <cmath>
#include <cstddef>

namespace gainroom {

class CountsBelow {
public:
    // Where the next one is: close to the lowest crossing's factor and far from it in turn, at another place each time.
    double factor(double lowest) const { return lowest * (1.0 - kDeepest * std::pow(kClosest, std::fmod(kGolden * double(turn_), 1.0))); }

    // One at `factor`, begun at the path `from`, has found so many pairs of unstable roots at `path`. `tells` false: it says nothing.
    void conclude(bool tells, double factor, long pairs, double from, double path) {
        empty_ = from != path ? 0 : at_ == path ? empty_ + 1 : 1;
        at_ = path;
        turn_++;
        if (!tells) return;
        found_at_ = factor;
        found_ = pairs;
        found_from_ = from;
        if (pairs == 0) return;
        turn_--;  // there once more, until a crossing has been found or the robot is elsewhere
        empty_ = 0;
    }

    // How many pairs the last one that told anything has found, which is forgotten as the path goes on, and at which factor.
    long found(double path) const { return path - found_from_ < kForgotten ? found_ : 0; }
    double found_at() const { return found_at_; }
    // Whether enough of them have found nothing in the posture of this path.
    bool are_empty(double path) const { return at_ == path && empty_ >= kEnough; }

private:
    static constexpr double kDeepest = 0.5, kClosest = 1e-5;  // of the lowest crossing's factor, below it; of the deepest
    static constexpr double kForgotten = 0.1;                 // of the path
    static constexpr double kGolden = 0.6180339887498949;
    static constexpr std::size_t kEnough = 400;

    std::size_t turn_ = 1, empty_ = 0;  // empty_: in a row at the path at_
    double at_ = -1.0, found_at_ = 0.0, found_from_ = 0.0;
    long found_ = 0;
};

}  // namespace gainroom
