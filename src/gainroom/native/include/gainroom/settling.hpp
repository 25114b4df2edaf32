// The first limit of a contact state, before a control loop begins.
#pragma once

#include <cmath>

#include "tracker.hpp"

namespace gainroom {

constexpr int kSettling = 20000;  // ticks within which the first certificate has to come
constexpr int kWidening = 1000;   // ticks after it, in which other crossings above it are found
constexpr double kAgreed = 1e-6;  // relative, of limits

// Repeats `tick` in one posture until the limit settles; true if it settles at `gain` [factor], which gain_limit found there.
template <class Tick>
bool settles(Tick tick, double gain, Limit& found) {
    found = tick();
    for (int k = 0; k < kSettling && !found.certified; k++) found = tick();
    for (int k = 0; k < kWidening; k++) found = tick();
    return std::fabs(found.gain - gain) <= kAgreed * gain;
}

}  // namespace gainroom
