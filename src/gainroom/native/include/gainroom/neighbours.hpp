// A check whether joint-space control that is about to lose stability at a crossing has lost it below already, by a root beside that crossing's own.
//
// Two roots that come close as the factor rises exchange what they go on to do where the posture changes a little (an avoided crossing). The one
// that turned back short of the boundary then passes it, and a pair of crossings is born below one that hardly moves: nothing that is followed
// leads there, and a count above sees a pair come and go. Near the crossing the roots are those of the loop in the span of its mode and of
// the modes that are nearest in frequency; these are kept from tick to tick by inverse iteration with the crossing's own factors.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "block.hpp"
#include "joint_law.hpp"
#include "near_pencil.hpp"
#include "symmetric_factor.hpp"
#include "tracked_loop.hpp"

namespace gainroom {

class Neighbours {
public:
    explicit Neighbours(const JointLaws& laws)
        : laws_(laws), size_(laws.size()), used_(std::min(NearPencil::kMost, size_)), values_(size_), modes_(used_ * size_), kept_(modes_),
          moved_(size_), trial_(size_), factor_(size_) {}

    static constexpr double kBeside = 0.05;  // of the lowest crossing's factor, above it: crossings that are looked beside

    // Whether nothing beside `crossing`, which has been followed to W, is unstable at factors a little below it and not above the lowest one's.
    // `factor`: of its matrix, nearly; `work` is counted in slices.
    bool clear(const double* w, TrackedCrossing& crossing, const TrackedCrossing& lowest, const SymmetricFactor& factor, double& work) {
        work += kLook;
        if (used_ < 2) return clear_for(crossing, 1.0, 0.0);
        laws_.at(crossing.omega, crossing.gain, values_.data());
        at_ = &crossing;
        if (!find_modes(crossing, factor) || !project(w, true)) return false;
        const bool is_lowest = &crossing == &lowest;
        if (is_lowest && !is_clear_here(w, crossing)) return false;
        const double moves = motion(w), far = pencil_.speed() * kWindow * crossing.gain, next = pencil_.distance();
        if (next > kApart * far && (is_lowest || pencil_.beside().imag() > 0.0)) return clear_for(crossing, next - kApart * far, moves);
        const double above = crossing.gain - lowest.gain, nearest = is_lowest ? 0.0 : above + kBelow * lowest.gain;
        const double least = is_lowest ? std::max(kWindow * std::min(1.0, kScale * next / far), kLeast) * crossing.gain : nearest;
        pencil_.look_at(nearest, lowest.omega - crossing.omega);
        for (int look = 0; look < kLooks; look++) {
            if (!pencil_.peak(above + kWindow * lowest.gain, least, kDoubt * crossing.omega, peak_))
                return clear_for(crossing, look > 0 ? 0.0 : pencil_.margin(), moves);
            work += kAtPeak;
            if (!is_stable(w)) return false;
            pencil_.narrow(peak_.root);  // it may have hidden one that is nearer
        }
        return false;
    }

    // Where the loop loses stability below the crossing (0) and where it has it back (1), after `clear` has said no: a start.
    bool start(int which, TrackedCrossing& trial) {
        const double end = which == 0 ? peak_.below : peak_.above;
        double by = peak_.by;
        if (pencil_.growth(by) > 0.0) by = pencil_.growth(end) > 0.0 ? end : pencil_.change(end, by);
        const Complex root = pencil_.least_stable(by);
        combine(pencil_, by, root);
        trial.begin(at_->omega + root.real(), at_->gain + by);
        trial.mode = moved_;
        return trial.gain > 0.0 && trial.omega > 0.0 && trial.normalize();
    }

private:
    static constexpr double kWindow = 0.1;               // of the crossing's factor, below it
    static constexpr double kApart = 2.0, kScale = 0.1;  // of how far roots move over the window; of the distance at which they begin to meet
    static constexpr double kLeast = 1e-6;               // of the factor: a pair that is nearer is within what safe_gain leaves
    static constexpr double kBelow = 1e-6;               // of the lowest crossing's, below it: where it is looked beside others
    static constexpr double kDoubt = 1e-4, kCertain = 1e-7;  // of ω: the span's error at the crossing; round-off
    static constexpr double kBend = 1.0;                // of δω²/ω: its error at δω, as laws bend over about ω
    static constexpr double kRough = 0.02;               // of δω: what modes that have been sharpened once leave
    static constexpr int kPasses = 4, kThere = 3;        // of the iteration where no modes are known, and at a peak
    static constexpr double kMoves = 3.0, kLongest = 0.02;  // what roots are taken to move, of what they do at most; of the path
    static constexpr double kLook = 0.5, kAtPeak = 2.0;  // work
    static constexpr int kLooks = 12;                    // for peaks, each nearer to the crossing's frequency than the one before
    static constexpr double kInside = 0.5;               // of its distance: what is nearer the span at the crossing tells better
    static constexpr int kSettling = 8;                  // steps to a root, each of which squares its error
    static constexpr double kSettled = 0.01;             // of its distance to the boundary
    static constexpr double kNear = 0.05;                // of ω: roots farther away are none that the span tells of

    Complex* mode(std::size_t k) { return &modes_[k * size_]; }

    // The crossing's mode and those beside it, orthonormal.
    bool find_modes(TrackedCrossing& crossing, const SymmetricFactor& factor) {
        std::copy(crossing.mode.begin(), crossing.mode.end(), modes_.begin());
        const bool known = crossing.beside.size() >= modes_.size() - size_ && crossing.has_beside;
        for (std::size_t k = size_; k < modes_.size(); k++) modes_[k] = known ? crossing.beside[k - size_] : scattered(k);
        for (int pass = known ? 1 : kPasses; pass > 0; pass--)
            for (std::size_t k = 1; k < used_; k++) {
                if (!sharpen(k, factor)) return crossing.has_beside = false;
            }
        if (crossing.beside.size() >= modes_.size() - size_) {
            std::copy(modes_.begin() + long(size_), modes_.end(), crossing.beside.begin());
            crossing.has_beside = true;
        }
        return true;
    }

    // How far roots move along the path, of a change of W by δ(W + 1/J), of any shape: those of the span at most, others at this frequency as
    // far as their modes are real.
    double motion(const double* w) const {
        double size = 0.0, other = 0.0;
        for (std::size_t i = 0; i < size_; i++) {
            const double own = w[i * size_ + i] + 1.0 / laws_.joint(i).motor_inertia;
            for (std::size_t k = 0; k < used_; k++) size += std::norm(modes_[k * size_ + i]) * own;
            other = std::max(other, own / size_of(values_[i].beta_omega));
        }
        return std::max(pencil_.give() * size, other);
    }

    // How long it holds that a root beside it is stable by `margin`: while what posture does to roots is much less.
    static bool clear_for(TrackedCrossing& crossing, double margin, double moves) {
        crossing.clear_for = std::min(margin / (kMoves * std::min(moves, crossing.omega)), kLongest);
        return true;
    }

    // No direction in particular.
    static Complex scattered(std::size_t k) { return {std::cos(1.7 * double(k) * double(k)), std::sin(0.9 * double(k) + double(k) * double(k))}; }

    bool orthonormal(std::size_t k) {
        Complex* x = mode(k);
        double size = norm(x);
        for (int again = 0; again < 3; again++) {  // what the crossing's own mode takes away is nearly all
            if (!(size > 0.0) || !std::isfinite(size)) return false;
            size = 1.0 / std::sqrt(size);
            for (std::size_t i = 0; i < size_; i++) x[i] *= size;
            if (again == 2) break;
            for (std::size_t m = 0; m < k; m++) {
                const Complex* other = mode(m);
                Complex share = 0.0;
                for (std::size_t i = 0; i < size_; i++) share += times(std::conj(other[i]), x[i]);
                for (std::size_t i = 0; i < size_; i++) x[i] -= times(share, other[i]);
            }
            size = norm(x);
        }
        return true;
    }

    double norm(const Complex* x) const {
        double sum = 0.0;
        for (std::size_t i = 0; i < size_; i++) sum += std::norm(x[i]);
        return sum;
    }

    // The loop in the span of the modes where values_ are; at the crossing, whose own M x = 0, or elsewhere.
    bool project(const double* w, bool here) {
        NearPencil::Square m{}, d{}, g{};
        for (std::size_t k = 0; k < used_; k++) {
            if (k > 0 || !here) multiply(w, mode(k));
            for (std::size_t j = 0; j <= k; j++) {
                const Complex *x = mode(k), *y = mode(j);
                for (std::size_t i = 0; i < size_; i++) {
                    const Complex both = times(x[i], y[i]);
                    d[k][j] += times(both, values_[i].beta_omega);
                    g[k][j] += times(both, values_[i].beta_gain);
                    if (j > 0 || !here) m[k][j] += times(y[i], moved_[i]);
                }
                d[j][k] = d[k][j];
                g[j][k] = g[k][j];
                m[j][k] = m[k][j];
            }
        }
        return pencil_.set(m, d, g, used_, kNear * at_->omega, kBend / at_->omega);
    }

    // moved_ = (W + diag β) x.
    void multiply(const double* w, const Complex* x) {
        product(w, x, size_, moved_.data());
        for (std::size_t i = 0; i < size_; i++) moved_[i] += times(values_[i].beta, x[i]);
    }

    // moved_: the mode of a root.
    void combine(const NearPencil& pencil, double by, Complex root) {
        Complex parts[NearPencil::kMost] = {};
        pencil.mode(by, root, parts);
        std::fill(moved_.begin(), moved_.end(), Complex(0.0));
        for (std::size_t k = 0; k < used_; k++)
            for (std::size_t i = 0; i < size_; i++) moved_[i] += times(parts[k], mode(k)[i]);
    }

    // Whether roots beside the crossing's own are stable at its factor: what has come to be unstable by then crosses below.
    bool is_clear_here(const double* w, const TrackedCrossing& crossing) {
        const Complex next = pencil_.beside();
        const double off = std::abs(next), certain = kCertain * crossing.omega;
        if (off < certain || pencil_.stability(next) > kRough * off + certain) return true;
        peak_ = {0.0, next, -kWindow * crossing.gain, 0.0};
        combine(pencil_, 0.0, next);
        return is_stable(w, crossing.omega, next);
    }

    // Whether roots at the peak are stable after all: the laws and the modes are those there, not a straight line from the crossing.
    bool is_stable(const double* w) {
        kept_ = modes_;
        laws_.at(at_->omega + peak_.root.real(), at_->gain + peak_.by, values_.data());
        factor_.factor(w, values_.data());
        bool known = true;
        for (int pass = 0; pass < kThere && known; pass++)
            for (std::size_t k = 0; k < used_ && known; k++) known = sharpen(k, factor_);
        std::swap(span_, pencil_);
        known = known && project(w, false);
        std::swap(span_, pencil_);
        const double omega = at_->omega + peak_.root.real();
        Complex roots[NearPencil::kMost];
        span_.roots_at(0.0, roots);
        for (std::size_t k = 0; k < used_ && known; k++) {
            const bool is_nearer = std::abs(roots[k] + peak_.root.real()) < kInside * std::abs(peak_.root);  // to the crossing: for the next look
            const bool is_known = pencil_.is_known(roots[k] + peak_.root.real());
            if (roots[k].imag() > kCertain * at_->omega || is_nearer || is_known) continue;
            combine(span_, 0.0, roots[k]);
            known = is_stable(w, omega, roots[k]);
        }
        modes_.swap(kept_);
        return known;
    }

    // The same of the root at `omega` + `off` by the span, whose mode is in moved_: the span may tell of one that the loop does not have, and what it
    // has instead is found by inverse iteration, with laws at the frequency where that leads. Where it leads far away there is nothing here.
    bool is_stable(const double* w, double omega, Complex off) {
        Vector<Complex>& x = trial_;
        x = moved_;
        for (int k = 0; k < kSettling; k++) {
            omega += off.real();
            if (!(std::fabs(omega - at_->omega) < kNear * at_->omega)) return std::isfinite(omega);
            off = Complex(0.0, off.imag());
            laws_.at(omega, at_->gain + peak_.by, values_.data());
            for (std::size_t i = 0; i < size_; i++) values_[i].beta += times(off, values_[i].beta_omega);
            factor_.factor(w, values_.data());
            for (std::size_t i = 0; i < size_; i++) x[i] = times(values_[i].beta_omega, x[i]);
            factor_.solve(x.data());
            const double size = 1.0 / std::sqrt(norm(x.data()));
            for (std::size_t i = 0; i < size_; i++) x[i] *= size;
            multiply(w, x.data());
            Complex f = 0.0, slope = 0.0;
            for (std::size_t i = 0; i < size_; i++) {
                f += times(x[i], moved_[i]);
                slope += times(times(x[i], x[i]), values_[i].beta_omega);
            }
            const Complex step = over(f, slope);
            off -= step;
            if (std::abs(step) < kSettled * std::fabs(off.imag())) return off.imag() > kCertain * at_->omega;
        }
        return false;
    }

    bool sharpen(std::size_t k, const SymmetricFactor& factor) {
        Complex* x = mode(k);
        for (std::size_t i = 0; i < size_; i++) x[i] = times(values_[i].beta_omega, x[i]);
        factor.solve(x);
        return orthonormal(k);
    }

    const JointLaws& laws_;
    std::size_t size_, used_;
    Vector<JointValue> values_;
    Vector<Complex> modes_, kept_, moved_, trial_;  // modes by rows, the crossing's own first
    SymmetricFactor factor_;
    NearPencil pencil_, span_;  // at the crossing, and at the peak
    NearPencil::Peak peak_;
    const TrackedCrossing* at_ = nullptr;
};

}  // namespace gainroom
