// The known crossings of a contact state as the posture changes: by rising gain, each of them once, none far above the lowest.
//
// At a tick the lowest is followed, every other one that might have come below it, and those that have been left behind the most.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "block.hpp"
#include "contact_state.hpp"

namespace gainroom {

class CrossingSet {
public:
    // Strides: see `approach`.
    CrossingSet(TrackedLoop& loop, double stride) : loop_(loop), stride_(stride), trial_(loop.mode_size()) {}

    TrackedLoop& loop() { return loop_; }
    double stride() const { return stride_; }

    // How far it is to `posture`; not finite where that is none.
    double distance(const ContactState& state, const double* posture) {
        return state.begun ? loop_.distance(state.posture.data(), posture) : 0.0;
    }

    // Crossings from where they were to `posture`, in strides: one, and more while there is room for work. False where this takes further ticks;
    // so it may be `after_switch`, with many crossings to be followed that have been left behind.
    bool approach(const double* posture, ContactState& state, double far, double room, bool after_switch, double& work) {
        if (begins(posture, state)) return true;
        state.ticks++;
        const bool jerked = !after_switch && far > kJerk * state.rate + kLeastJerk, jumped = jerked || far > kJump || state.put_off > 0;
        if (jerked) state.doubt();
        bool is_late = false;
        for (int k = 0; k == 0 || 2.0 * work < room; k++) {
            if (k > 0) far = distance(state, posture), work += kStride;
            const bool there = stride(posture, state, far, stride_);
            if (!there) state.sweeping = state.slowing = false;
            follow_lowest(state, work);
            if (there && k == 0) {
                for (std::size_t m = 1; m < state.count; m++) {
                    TrackedCrossing& one = *state.order[m];
                    const double left = state.path - one.seen_at;
                    const double off = std::max(state.speed(one) * left, one.converged ? 0.0 : kRough);
                    const bool may_be_lowest = one.gain * (1.0 - off) < state.order[0]->gain;
                    const bool stale = left > 0.0 && double(state.ticks - one.looked_at) > (2.0 * work < room ? 1.0 : 2.0) * ContactState::kStale;
                    is_late = work > room && after_switch && state.put_off < kPutOff;
                    if (is_late) break;
                    if (left > 2.0 * kLate || ((may_be_lowest || jumped || stale) && !is_above(state, one, left, work))) {
                        if (!follow(state, m, false, work)) m--;  // another one is in its place
                    }
                }
                if (!is_late) follow_late(state, kFew, kLate, work);
            } else {
                follow_late(state, state.count, 0.0, work);
            }
            arrange(state, work);
            if (!there) continue;
            state.put_off = is_late ? state.put_off + 1 : 0;
            if (is_late) return false;
            look_below(state, work);
            return true;
        }
        return false;
    }

    // The same with no more work than there is room for, where it does not matter how far it comes and how exact crossings are.
    bool draw_near(const double* posture, ContactState& state, double far, double room, double& work) {
        if (begins(posture, state)) return true;
        const bool there = stride(posture, state, far, stride_);
        follow_lowest(state, work);
        follow_late(state, state.count, kLate, work, true, room);
        arrange(state, work);
        return there;
    }

    // Takes `found`, which has just been followed here, among the crossings; leaves there what is to be used again.
    void keep(ContactState& state, TrackedCrossing& found) {
        if (found.gain < state.counted) state.counted = 0.0;  // the count did not know it
        state.kept = {};
        if (state.count == state.order.size()) {
            if (found.gain > state.order.back()->gain) return;
            state.count--;
        }
        std::swap(found, *state.order[state.count++]);
        double work = 0.0;
        arrange(state, work);
    }

    // Whether two crossings have become one; where they look alike, both are followed to the end.
    bool doubles(ContactState& state, TrackedCrossing& old, TrackedCrossing& now, double& work) {
        if (std::fabs(old.gain - now.gain) > 0.02 * now.gain || std::fabs(old.omega - now.omega) > 0.02 * now.omega) return false;
        if (here(state, old) && here(state, now) && !same_place(old, now)) return false;
        if (std::norm(product(old.mode, now.mode)) < 0.5) return false;
        if (!settled(state, old, work) || !settled(state, now, work)) return true;
        return same_place(old, now) && std::norm(product(old.mode, now.mode)) > 0.99;
    }

    static Complex product(const Vector<Complex>& a, const Vector<Complex>& b) {
        Complex sum = 0.0;
        for (std::size_t i = 0; i < a.size(); i++) sum += times(std::conj(a[i]), b[i]);
        return sum;
    }

private:
    static constexpr double kForgets = 0.95, kDouble = 1e-5;  // see arrange, moved, doubles
    static constexpr double kPassed = 1.2;  // of `lowest`
    static constexpr double kLate = 0.06;    // a path along which a crossing is left; twice as long at most
    static constexpr double kJump = 0.02;    // a path within a tick after which all are looked at
    static constexpr double kJerk = 3.0, kLeastJerk = 1e-3;  // the same of a path that is so much longer than those of before
    static constexpr double kStride = 0.1;   // work of a further stride, also where no crossing is known
    static constexpr double kRough = 0.01;  // a gain that has been followed roughly is nearer than this
    static constexpr int kPutOff = 3;       // ticks after a switch that may leave some of what is to be followed to the next one
    static constexpr int kBelow = 3;        // looks below the lowest, which is another one then
    static constexpr std::size_t kFew = 2, kSome = 6;  // that are followed, or looked beside, at a tick; where there is no certificate without that

    static bool begins(const double* posture, ContactState& state) {
        if (state.begun) return false;
        std::copy_n(posture, state.posture.size(), state.posture.begin());
        return state.begun = true;
    }

    // Whether a crossing that has been `left` is above the lowest, seen without following it.
    bool is_above(ContactState& state, TrackedCrossing& one, double left, double& work) {
        if (!one.converged || !(loop_.least_gain(state.posture.data(), one, left, work) > state.order[0]->gain)) return false;
        one.looked_at = state.ticks;
        return true;
    }

    // Whether the loop is unstable below the lowest crossing, beside it or beside one that is near above it, a few of those at a time; what crosses
    // there is known from now on.
    void look_below(ContactState& state, double& work) {
        std::size_t others = 0;
        for (int found = 0; state.count > 0;) {
            const std::size_t k = state.due();
            if (k == state.count) return;
            TrackedCrossing& one = *state.order[k];
            if (k > 0 && others >= (one.clear ? kFew : kSome)) return;
            if (!here(state, one)) {
                if (k == 0) return;
                if (!settled(state, one, work)) drop(state, k);
                arrange(state, work);
                continue;  // another one may be the lowest
            }
            others += k > 0;
            one.clear_anew = one.clear_at == state.path;
            if (one.clear_anew) one.has_beside = false;
            one.clear_at = state.path;
            one.clear_tick = state.ticks;
            one.clear_as_lowest = k == 0;
            one.clear_for = 0.0;
            one.clear = loop_.clear_below(state.posture.data(), one, *state.order[0], work);
            if (!one.clear && (!found_below(state, work) || ++found == kBelow)) return;
        }
    }

    bool found_below(ContactState& state, double& work) {
        const double counted = state.counted;
        double balance = 0.0;
        int found = 0;
        for (int which = 0; which < 2; which++) {
            if (!loop_.start_below(which, trial_) || !is_new(state, work)) continue;
            balance += trial_.rising > 0.0 ? 1.0 : -1.0;
            found += trial_.gain < counted;
            keep(state, trial_);
        }
        if (found == 2 && balance == 0.0) state.counted = counted;  // a pair that comes and goes: the count is that of before
        return found > 0;
    }

    bool is_new(ContactState& state, double& work) {
        if (!loop_.follow(state.posture.data(), trial_, 10, work, false)) return false;
        if (!(trial_.gain > 0.0 && trial_.omega > loop_.lowest() && trial_.omega < highest_omega())) return false;
        trial_.seen_at = state.path;
        trial_.speed = 0.0;  // not known: as the others
        for (std::size_t k = 0; k < state.count; k++) trial_.speed = std::max(trial_.speed, state.order[k]->speed);
        for (std::size_t k = 0; k < state.count; k++)
            if (doubles(state, *state.order[k], trial_, work)) return false;
        return true;
    }

    // Towards `posture`, which is `far`, by `most`; true where it is there.
    static bool stride(const double* posture, ContactState& state, double far, double most) {
        const bool there = !(far > most);
        const double share = there ? 1.0 : std::min(0.5, most / far);
        for (std::size_t m = 0; m < state.posture.size(); m++)
            state.posture[m] = there ? posture[m] : state.posture[m] + share * (posture[m] - state.posture[m]);
        state.path += share * far;
        return there;
    }

    void follow_lowest(ContactState& state, double& work) {
        while (state.count > 0 && !follow(state, 0, false, work)) continue;
    }

    // Those that have been left the longest, if longer than `late`.
    void follow_late(ContactState& state, std::size_t most, double late, double& work, bool rough = false, double room = 1e300) {
        for (; most > 0 && work < room; most--) {
            double longest = late;
            std::size_t oldest = state.count;
            for (std::size_t k = 0; k < state.count; k++)
                if (const double left = state.path - state.order[k]->seen_at; left > longest) {
                    longest = left;
                    oldest = k;
                }
            if (oldest == state.count) return;
            follow(state, oldest, rough, work);
        }
    }

    // False where it is lost, and its place is another's.
    bool follow(ContactState& state, std::size_t k, bool rough, double& work) {
        const bool found = moved(state, *state.order[k], rough, work);
        if (!found) drop(state, k);
        return found;
    }

    bool moved(ContactState& state, TrackedCrossing& one, bool rough, double& work) {
        const double before = one.gain;
        one.predict(state.path - one.seen_at);
        bool found = loop_.follow(state.posture.data(), one, 6, work, rough);
        if (!found) {
            go_back(one);
            one.mode = one.before;
            found = loop_.follow(state.posture.data(), one, 8, work, false);
        }
        if (const double ahead = state.path - one.seen_at; ahead > 1e-9)
            one.speed = std::max(std::fabs(std::log(one.gain / before)) / ahead, kForgets * one.speed);
        one.seen_at = state.path;
        one.looked_at = state.ticks;
        return found && one.gain > 0.0 && one.omega > loop_.lowest() && one.omega < highest_omega();
    }

    static bool here(const ContactState& state, const TrackedCrossing& one) { return one.seen_at == state.path && one.converged; }

    static bool same_place(const TrackedCrossing& a, const TrackedCrossing& b) {
        return std::fabs(a.gain - b.gain) < kDouble * a.gain && std::fabs(a.omega - b.omega) < kDouble * a.omega;
    }

    // Followed here, and to the end.
    bool settled(ContactState& state, TrackedCrossing& one, double& work) {
        if (one.seen_at != state.path) return moved(state, one, false, work);
        return one.converged || loop_.follow(state.posture.data(), one, 8, work, false);
    }

    double highest_omega() const { return loop_.sample_time() > 0.0 ? kPi / loop_.sample_time() : 1e9; }

    // One that could not be followed has a gain that says nothing: that of before counts as well.
    void drop(ContactState& state, std::size_t k) {
        const TrackedCrossing& one = *state.order[k];
        if (one.omega < kPassed * loop_.lowest()) state.slow_counted = 0.0;  // it may have gone where the slow count says that nothing crosses
        if (std::min(one.gain, one.gain_before) < state.counted) state.counted = 0.0;  // the count relied on it
        state.kept = {};
        std::rotate(state.order.begin() + long(k), state.order.begin() + long(k) + 1, state.order.begin() + long(state.count));
        state.count--;
    }

    void arrange(ContactState& state, double& work) {
        sort(state);
        for (std::size_t k = 0; k < state.count; k++) {
            if (state.order[k]->seen_at != state.path) continue;  // nothing new about it
            for (std::size_t m = 0; m < state.count; m++)
                if (m != k && doubles(state, *state.order[m], *state.order[k], work)) {
                    const bool later = jump(*state.order[m]) > jump(*state.order[k]);
                    if (recovered(state, later ? m : k, later ? k : m, work)) continue;
                    drop(state, std::max(k, m));
                    if (m < k) k--;
                    break;
                }
        }
        sort(state);
        while (state.count > 1 && state.order[state.count - 1]->gain > loop_.followed() * state.order[0]->gain) state.count--;
    }

    static void sort(ContactState& state) {
        const auto first = state.order.begin();
        for (std::size_t i = 1; i < state.count; i++)
            for (std::size_t j = i; j > 0 && state.order[j]->gain < state.order[j - 1]->gain; j--) std::swap(first[long(j)], first[long(j - 1)]);
    }

    // To where it was before the last step.
    static void go_back(TrackedCrossing& one) {
        one.omega = one.omega_before;
        one.gain = one.gain_before;
        one.factored = 0;
        one.stride = 0.0;
    }

    // How far the last step has taken a crossing.
    static double jump(const TrackedCrossing& one) {
        return std::fabs(one.gain - one.gain_before) / one.gain + std::fabs(one.omega - one.omega_before) / one.omega;
    }

    // A crossing that has come upon another one, followed again from where it was, in what is left of its mode beside the other's.
    bool recovered(ContactState& state, std::size_t lost, std::size_t other, double& work) {
        TrackedCrossing& one = *state.order[lost];
        if (!(one.gain_before > 0.0)) return false;
        go_back(one);
        const Complex share = product(state.order[other]->mode, one.before);
        for (std::size_t i = 0; i < one.mode.size(); i++) one.mode[i] = one.before[i] - times(share, state.order[other]->mode[i]);
        if (!one.normalize() || !loop_.follow(state.posture.data(), one, 8, work, false)) return false;
        for (std::size_t k = 0; k < state.count; k++)
            if (k != lost && doubles(state, *state.order[k], one, work)) return false;
        return one.gain > 0.0 && one.omega > loop_.lowest() && one.omega < highest_omega();
    }

    TrackedLoop& loop_;
    double stride_;
    TrackedCrossing trial_;
};

}  // namespace gainroom
