// The search for crossings of joint-space control: where the locus of a mode becomes real, and in random directions.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "block.hpp"
#include "crossing_search.hpp"
#include "joint_loop.hpp"
#include "mode_basis.hpp"

namespace gainroom {

class JointSearch final : public CrossingSearch {
public:
    JointSearch(JointLoop& loop, CrossingSet& known, std::size_t contacts)
        : CrossingSearch(known), loop_(loop), values_(loop.channels()), weight_(loop.channels()), loci_(contacts, Loci(loop.laws())) {}

    // At the first slice of a count that is searched along: modes at this W, unless they are of one nearby, and where their loci are.
    double begin(ContactState& state) override {
        Loci& own = loci_[state.number];
        double work = 0.0;
        own.looked_at = own.spent = 0.0;
        if (!(own.based_at > state.path - 0.5 * known_.stride())) {
            own.basis.begin(state.posture.data());
            own.based_at = state.path;
            work = kBasis * double(loop_.mode_size());
        }
        if (own.basis.ready()) find_loci(own, state);
        return work;
    }

    // At one slice of the count; what it cost.
    double look(ContactState& state) override {
        Loci& own = loci_[state.number];
        double work = 0.5;
        if (!own.basis.ready()) {
            for (int k = 0; k < 3 && !own.basis.ready(); k++) own.basis.rotate();
            own.looked_at = 0.0;
            return work;
        }
        const double from = own.looked_at, omega = state.sweep.omega();
        if (!(omega > from)) return work;  // a step that was shortened
        own.before.swap(own.now);
        find_loci(own, state);
        const std::size_t size = own.now.size();
        for (std::size_t m = 0; from > 0.0 && m < size && work < kEnough; m++) {
            const std::size_t k = (m + own.tries) % size;
            const Complex a = own.before[k], b = own.now[k];
            if (!(a.imag() * b.imag() <= 0.0)) continue;
            if (!(std::fmax(a.real(), b.real()) > 0.0 && std::fmin(a.real(), b.real()) < 2.0 * kBeyond * state.sweep.gain())) continue;
            const Place place = real_place(state, own.basis, k, {from, a}, {omega, b});
            work += 0.2;
            if (!(place.locus.real() > 0.0 && place.locus.real() < kBeyond * state.sweep.gain())) continue;
            start(place.omega, place.locus.real());
            own.basis.mode(k, trial_.mode.data());
            if (trial_.normalize() && unlike_known(state)) take(state, work);
        }
        const bool is_turn = std::fmod(0.618 * double(++own.tries), 1.0) <= 0.34 && work <= kEnough;
        // Where the robot moves, a count that is long under way is worth little.
        if (is_turn && !(state.path > state.sweep_from && own.spent > state.sweep.spent())) try_somewhere(own, state, work);
        own.spent += work;
        return work;
    }

    double look_at(ContactState& state, double omega) override {
        double work = kFactor;
        try_direction(state, omega, state.sweep.gain(), work);
        return work;
    }

private:
    static constexpr double kNear = 0.05, kUnlike = 0.2;  // of crossings that are alike
    static constexpr int kRefined = 4;
    static constexpr double kEnough = 1.5;  // work at a slice
    static constexpr double kFactor = 0.7, kBasis = 0.08;  // work; of one joint of a basis

    // Of one contact state.
    struct Loci {
        explicit Loci(const JointLaws& laws) : basis(laws), now(laws.size()), before(laws.size()) {}

        ModeBasis basis;
        Vector<Complex> now, before;
        double looked_at = 0.0, based_at = -1e300;  // the frequency of `now`; the path at which the modes were begun
        double spent = 0.0;                         // on this count
        std::size_t tries = 0;
    };

    // At the slice of the count.
    void find_loci(Loci& own, const ContactState& state) {
        own.looked_at = state.sweep.omega();
        loop_.laws().at(state.sweep.omega(), state.sweep.gain(), values_.data());
        own.basis.at(values_.data(), state.sweep.gain());
        for (std::size_t k = 0; k < own.now.size(); k++) own.now[k] = own.basis.locus(k);
    }

    struct Place {
        double omega;
        Complex locus;
    };

    // Where the locus of mode k becomes real, between two frequencies; the slices are too far apart for a line through them.
    Place real_place(const ContactState& state, ModeBasis& basis, std::size_t k, Place below, Place above) {
        Place found = below;
        for (int step = 0; step < kRefined; step++) {
            const double a = below.locus.imag(), b = above.locus.imag();
            found.omega = below.omega + (a == b ? 0.5 : a / (a - b)) * (above.omega - below.omega);
            loop_.laws().at(found.omega, state.sweep.gain(), values_.data());
            basis.at(values_.data(), state.sweep.gain());
            found.locus = basis.locus(k);
            (found.locus.imag() * a > 0.0 ? below : above) = found;
        }
        return found;
    }

    // A random direction: here, or beside a known crossing, as equal limbs have theirs close together.
    void try_somewhere(const Loci& own, ContactState& state, double& work) {
        std::size_t below = 0;
        while (below < state.count && state.order[below]->gain < 1.02 * state.sweep.gain()) below++;
        const TrackedCrossing* near = own.tries % 2 == 0 && below > 0 ? state.order[own.tries / 2 % below] : nullptr;
        try_direction(state, near ? near->omega : state.sweep.omega(), near ? 1.001 * near->gain : state.sweep.gain(), work);
    }

    void try_direction(ContactState& state, double omega, double gain, double& work) {
        start(omega, gain);
        const SymmetricFactor& factor = loop_.follower().at(state.posture.data(), trial_.omega, trial_.gain);
        weigh();
        for (int pass = 0; pass < 3; pass++) {
            work += 0.5;
            if (!away(state)) return;
            for (std::size_t i = 0; i < trial_.mode.size(); i++) trial_.mode[i] = times(trial_.mode[i], weight_[i]);
            if (!CrossingFollower::sharpen(factor, trial_)) return;
        }
        if (away(state)) take(state, work);
    }

    // A start from nothing but a place: another direction every time, so that equal crossings are found one by one.
    void start(double omega, double gain) {
        for (Complex& x : trial_.mode) {
            seed_ = seed_ * 6364136223846793005u + 1442695040888963407u;
            x = double(seed_ >> 11) * 0x1p-52 - 1.0;
        }
        trial_.begin(omega, gain);
    }

    // Modes x of crossings at one frequency are orthogonal as x^T diag(weight) y, with the weight ∂β/∂g; here where trial_ is.
    void weigh() {
        loop_.laws().at(trial_.omega, trial_.gain, values_.data());
        for (std::size_t i = 0; i < weight_.size(); i++) weight_[i] = values_[i].beta_gain;
    }

    // trial_'s mode without those of known crossings about its frequency; elsewhere the same mode may cross again.
    bool away(const ContactState& state) {
        for (std::size_t k = 0; k < state.count; k++)
            if (std::fabs(state.order[k]->omega - trial_.omega) < kNear * trial_.omega) subtract_mode(state.order[k]->mode);
        return trial_.normalize();
    }

    void subtract_mode(const Vector<Complex>& known) {
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
        return left > kUnlike && trial_.normalize();
    }

    JointLoop& loop_;
    Vector<JointValue> values_;
    Vector<Complex> weight_;
    Vector<Loci> loci_;
    std::uint64_t seed_ = 1;
};

}  // namespace gainroom
