// Crossings that are not known yet, looked for along a count: where the locus of a mode becomes real, and in random directions.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "crossing_set.hpp"

namespace gainroom {

class CrossingSearch {
public:
    CrossingSearch(const JointLaws& laws, double passive_end, CrossingSet& known)
        : laws_(laws), values_(laws.size()), weight_(laws.size()), known_(known), trial_(laws.size()), passive_end_(passive_end) {}

    // Before a count that is searched along: modes at this W, unless they are of one nearby.
    void begin(ContactState& state) const {
        if (state.based_at > state.path - 0.5 * known_.stride()) return;
        state.basis.begin(state.w.data());
        state.based_at = state.path;
    }

    // At one slice of the count; what it cost.
    double look(ContactState& state) {
        double work = 0.5;
        if (!state.basis.ready()) {
            for (int k = 0; k < 3 && !state.basis.ready(); k++) state.basis.rotate();
            state.looked_at = 0.0;
            return work;
        }
        const double from = state.looked_at, omega = state.sweep.omega();
        if (!(omega > from)) {  // a new count; or a step that was shortened
            if (omega < from) state.looked_at = 0.0;
            return work;
        }
        state.looked_at = omega;
        state.loci_before.swap(state.loci);
        state.basis.at(state.sweep.values(), state.sweep.gain());
        for (std::size_t k = 0; k < state.loci.size(); k++) state.loci[k] = state.basis.locus(k);
        const std::size_t size = state.loci.size();
        for (std::size_t m = 0; from > 0.0 && m < size && work < kEnough; m++) {
            const std::size_t k = (m + state.tries) % size;
            const Complex a = state.loci_before[k], b = state.loci[k];
            if (!(a.imag() * b.imag() <= 0.0)) continue;
            if (!(std::fmax(a.real(), b.real()) > 0.0 && std::fmin(a.real(), b.real()) < 2.0 * kBeyond * state.sweep.gain())) continue;
            const Place place = real_place(state, k, {from, a}, {omega, b});
            work += 0.2;
            if (!(place.locus.real() > 0.0 && place.locus.real() < kBeyond * state.sweep.gain())) continue;
            known_.solver().begin(place.omega, place.locus.real(), trial_);
            state.basis.mode(k, trial_.mode.data());
            if (CrossingFollower::normalize(trial_.mode) && unlike_known(state)) take(state, work);
        }
        if (std::fmod(0.618 * double(++state.tries), 1.0) > 0.34 || work > kEnough) return work;
        // A random direction: here, or beside a known crossing, as equal limbs have theirs close together.
        std::size_t below = 0;
        while (below < state.count && state.order[below]->gain < 1.02 * state.sweep.gain()) below++;
        const TrackedCrossing* near = state.tries % 2 == 0 && below > 0 ? state.order[state.tries / 2 % below] : nullptr;
        known_.solver().begin(near ? near->omega : omega, near ? 1.001 * near->gain : state.sweep.gain(), trial_);
        const SymmetricFactor& factor = near ? known_.solver().at(state.w.data(), trial_.omega, trial_.gain) : state.sweep.factor();
        weigh();
        for (int pass = 0; pass < 3; pass++) {
            work += 0.5;
            if (!away(state)) return work;
            for (std::size_t i = 0; i < trial_.mode.size(); i++) trial_.mode[i] = times(trial_.mode[i], weight_[i]);
            if (!CrossingFollower::sharpen(factor, trial_)) return work;
        }
        if (away(state)) take(state, work);
        return work;
    }

private:
    static constexpr double kCluster = 1e-3, kDependent = 0.01, kNear = 0.05, kUnlike = 0.2;  // of crossings that are alike
    static constexpr int kRefined = 4;
    static constexpr double kEnough = 1.5;  // work at a slice
    static constexpr double kBeyond = 1.5;                                     // of the factor of a count: what is kept

    struct Place {
        double omega;
        Complex locus;
    };

    // Where the locus of mode k becomes real, between two frequencies; the slices are too far apart for a line through them.
    Place real_place(ContactState& state, std::size_t k, Place below, Place above) {
        Place found = below;
        for (int step = 0; step < kRefined; step++) {
            const double a = below.locus.imag(), b = above.locus.imag();
            found.omega = below.omega + (a == b ? 0.5 : a / (a - b)) * (above.omega - below.omega);
            laws_.at(found.omega, state.sweep.gain(), values_.data());
            state.basis.at(values_.data(), state.sweep.gain());
            found.locus = state.basis.locus(k);
            (found.locus.imag() * a > 0.0 ? below : above) = found;
        }
        return found;
    }

    // Modes x of crossings at one frequency are orthogonal as x^T diag(weight) y, with the weight ∂β/∂g; here where trial_ is.
    void weigh() {
        laws_.at(trial_.omega, trial_.gain, values_.data());
        for (std::size_t i = 0; i < weight_.size(); i++) weight_[i] = values_[i].beta_gain;
    }

    // trial_'s mode without those of known crossings about its frequency; elsewhere the same mode may cross again.
    bool away(const ContactState& state) {
        for (std::size_t k = 0; k < state.count; k++)
            if (std::fabs(state.order[k]->omega - trial_.omega) < kNear * trial_.omega) subtract_mode(state.order[k]->mode);
        return CrossingFollower::normalize(trial_.mode);
    }

    void subtract_mode(const std::vector<Complex>& known) {
        Complex share = 0.0, whole = 0.0;
        for (std::size_t i = 0; i < known.size(); i++) {
            const Complex weighted = times(weight_[i], known[i]);
            share += times(weighted, trial_.mode[i]);
            whole += times(weighted, known[i]);
        }
        share = over(share, whole);
        if (!(std::norm(share) < 100.0)) return;  // the mode is orthogonal to itself, nearly
        for (std::size_t i = 0; i < known.size(); i++) trial_.mode[i] -= times(share, known[i]);
    }

    void subtract_share(const std::vector<Complex>& known) {
        const Complex share = CrossingSet::product(known, trial_.mode);
        for (std::size_t i = 0; i < known.size(); i++) trial_.mode[i] -= times(share, known[i]);
    }

    // Whether trial_'s mode is no combination of those of the known crossings at its place: equal joints that contacts hold have equal
    // crossings, as many as there are directions. It is made orthogonal to them on the way, which leaves it a mode of the same crossing.
    bool independent(const ContactState& state) {
        for (int pass = 0; pass < 3; pass++) {
            for (std::size_t k = 0; k < state.count; k++) {
                const TrackedCrossing& known = *state.order[k];
                if (std::fabs(known.gain - trial_.gain) < kCluster * trial_.gain && std::fabs(known.omega - trial_.omega) < kCluster * trial_.omega &&
                    known.rising * trial_.rising > 0.0)
                    subtract_share(known.mode);
            }
            double left = 0.0;
            for (const Complex& x : trial_.mode) left += std::norm(x);
            if (!(left > kDependent)) return false;
            left = 1.0 / std::sqrt(left);
            for (Complex& x : trial_.mode) x *= left;
        }
        return true;
    }

    // trial_, a start, without what is known already where it is; false where that is nearly all of it.
    bool unlike_known(const ContactState& state) {
        weigh();
        for (std::size_t k = 0; k < state.count; k++) {
            const TrackedCrossing& known = *state.order[k];
            if (std::fabs(known.gain - trial_.gain) < kNear * trial_.gain && std::fabs(known.omega - trial_.omega) < kNear * trial_.omega)
                subtract_mode(known.mode);
        }
        double left = 0.0;
        for (const Complex& x : trial_.mode) left += std::norm(x);
        return left > kUnlike && CrossingFollower::normalize(trial_.mode);
    }

    // Follows trial_ to a crossing, and keeps it where it is one of its own.
    void take(ContactState& state, double& work) {
        if (!known_.solver().follow(state.w.data(), trial_, 8, work)) return;
        if (!(trial_.gain > 0.0 && trial_.gain < kBeyond * state.sweep.gain())) return;
        if (!(trial_.omega > passive_end_ && trial_.omega < state.sweep.top())) return;
        trial_.seen_at = state.path;
        trial_.speed = 0.0;  // not known: as the others
        for (std::size_t k = 0; k < state.count; k++) trial_.speed = std::max(trial_.speed, state.order[k]->speed);
        for (std::size_t k = 0; k < state.count; k++)
            if (known_.doubles(state, *state.order[k], trial_, work)) return;
        if (independent(state)) known_.keep(state, trial_);
    }

    const JointLaws& laws_;
    std::vector<JointValue> values_;
    std::vector<Complex> weight_;
    CrossingSet& known_;
    TrackedCrossing trial_;
    double passive_end_;
};

}  // namespace gainroom
