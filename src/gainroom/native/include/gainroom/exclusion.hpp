// Intervals of ω in which no factor on all gains, from some g₀ to some g, puts a closed-loop root of coupled joints on the boundary.
//
// With a factor 1/u a root at jω makes F = Q + u D singular: Q = x P, D = diag(d_i) (modal_loop.hpp). F is complex symmetric. If one angle θ
// makes
//
//   Re(e^{jθ} (Q + v D)) > 0,  v = 1/g,   and   Re(e^{jθ} (Q + w D)) > 0,  w = 1/g₀,   or   Re(e^{jθ} D) > 0, which is w = ∞,
//
// then Re(e^{jθ} F) > 0 for all u between: none puts a root there. Over an interval both sides are interpolated between its ends; what
// interpolation misses of Q is at most Σ |φ_k φ_kᵀ| e_k, with the e_k of modal_loop.hpp, and is taken off. A failed Cholesky factorisation
// gives an x for which only part of a circle of angles is left: the cuts find an angle or show that there is none.
//
// Matrices with a positive real part are a convex set, in which the pivots p_i of e^{jθ} F have one too (Schur complements keep it). So over an
// excluded interval arg det F changes by the change of Σ arg(e^{jθ} p_i), no more and no less: `turned` adds that up for the factor 1.
//
// Just below a limit that is not enough: the vector x of the root that is about to cross is complex, while the test asks about real ones.
// There unknowns are mixed by T = I + j U (VᵀV)⁻¹ Vᵀ, X = V + j U the vectors of roots that cross: T V = X, so that they become real, and
// Tᵀ D T takes the place of D. Then the test holds as near to the limit as one likes. n vectors are T itself: those that make Q and D
// diagonal at one ω, each turned so that θ = 0 serves it, decide all about it.
//
// What holds from rest holds of every joint's own factor from 0 to g: that adds Re(e^{jθ} d_i) (1/g_i − v) >= 0 on the diagonal. And where one
// θ serves both D and e^{−jωτ} D, ωτ < π, it serves all delays between: there Re(e^{jθ} e^{−jωt} d_i) > 0, so it is concave in t, and
// Re(e^{jθ} F) is at least what its two ends have, weighted by t. Delays are halved in an interval where they turn D by too much for one θ.
//
// Gains that couple joints need not leave F (r, r) symmetric. Then F₂ = [½(F + Fᵀ), ½j(F − Fᵀ); −½j(F − Fᵀ), ½(F + Fᵀ)], which is, takes its
// place (`twofold`): aᵀ and bᵀ of x = a + jb make x̄ᵀ F x of it, so that Re F₂ > 0 where F + Fᴴ > 0, and det F₂ = det(F)². Its vectors at a
// root, of yᵀ F = 0 and F x = 0, are z = ½(y + x, j(y − x)) and the same with y → jy, x → −jx.
#pragma once

#include "sampled_form.hpp"

namespace gainroom {

struct Interval {
    double low, high;
};

class Exclusion : private SampledForm {
   public:
    double turned = 0.0;  // arg det F over what was excluded, at the factor 1, which has to be between; only where `counting`

    // Factors from `from`, 0: from rest, to `gain`. `alignment`: part of the joints' phase differences that is turned away beforehand, 0 to 1.
    // `crossing`: X (count, n).
    Exclusion(const ModalLoop& loop, double from, double gain, double alignment, bool counting = false, const Complex* crossing = nullptr,
              std::size_t crossing_count = 0)
        : SampledForm(loop, 1 / gain, alignment, crossing, crossing_count),
          more_(from > 0 ? 1 / from - 1 / gain : -1.0),
          counting_(counting),
          law_bends_(n_),
          missed_(n_ * stride_),
          law_missed_(mixed() ? n_ * stride_ : 0),
          trial_(n_ * stride_),
          vector_(n_) {}

    // Appends the parts of `open` that are left undecided at a relative width of `floor`; units, samples and angles are carried from one
    // interval to the next. Once `most` samples have been taken nothing more is decided.
    void run(const std::vector<Interval>& open, double floor, std::int64_t most, std::vector<Interval>& undecided) {
        double units_end = 0.0;
        for (std::size_t k = 0; k < open.size(); k++) {
            const double low = open[k].low, high = open[k].high;
            if (!(high > low) || !(low > 0)) continue;
            if (k == 0 || open[k - 1].high != low || !(high <= units_end)) {
                units_end = high;
                for (std::size_t l = k + 1; l < open.size() && open[l].low == units_end && open[l].high <= kSpan * low; l++)
                    units_end = open[l].high;
                align(low, units_end);
                sample(nodes_[left_], low);
            }
            run(high, floor, most, undecided);
        }
    }

    // From where up to `high` gains up to this one are too small for a root at jω, however late they act: Σ_j |Q_ij| < v |d_i| in all rows.
    // `tail`: arg det(I + L) there; on from there it goes to 0, as I + L stays near I. In continuous time it has to be so at `high`.
    double too_small_from(double low, double high, double* tail = nullptr) {
        int at = 0;
        align(high / kStride, high);
        sample(nodes_[at], high);
        if (tail != nullptr && loop_.step == 0) *tail = argument_of_loop(nodes_[at]);
        while (high > low) {
            sample(nodes_[1 - at], std::max(high / kStride, low));
            if (!too_small(nodes_[1 - at], nodes_[at])) break;
            at = 1 - at;
            high = nodes_[at].omega;
            if (tail != nullptr) *tail = argument_of_loop(nodes_[at]);
        }
        return high;
    }

    // What of [low, high] is left where Re(j d_i) > 0 is not known for all i. Of plants that give out no energy, Re(j Q) >= 0, there is no root
    // at jω with any gains where it is.
    std::vector<Interval> not_leading(double low, double high) {
        std::vector<Interval> left;
        double stride = kStride, leading = 0.0;  // from where it leads up to `low`
        while (low < high) {
            const double next = low * stride < high ? low * stride : high;
            if (leads(low, next)) {
                if (leading == 0) leading = low;
                low = next;
            } else if (leading > 0 && stride > kLeast) {
                stride = std::sqrt(stride);
            } else {
                if (leading > 0) turned += turned_leading(leading, low);
                leading = 0.0;
                stride = kStride;
                add(left, low, std::min(low * kStride, high));
                low = left.back().high;
            }
        }
        if (leading > 0) turned += turned_leading(leading, high);
        return left;
    }

   private:
    static constexpr int kDepth = 48, kCuts = 24;
    static constexpr double kRounding = 1e-13, kCoarse = 0.05;
    static constexpr double kSpan = 3.0;  // from end to end of what shares units, at most, but for wider intervals
    static constexpr double kStride = 1.3, kLeast = 1.01, kSafe = 1e-9;

    // A matrix that has to be positive, less what may be missed: of Re(e^{jθ} (real + j imaginary)) and, `more` times, of Re(e^{jθ} D).
    struct Test {
        const double *real, *imaginary, *missed;
        const Node* node = nullptr;
        double more = 0.0;
    };

    const double more_;  // w - v; < 0: w = ∞
    const bool counting_;
    Node nodes_[kDepth + 2];
    int left_ = 0;           // the node where the next interval begins
    std::size_t alone_ = 0;  // the joint whose d_i has failed, n: the whole matrix; and that d_i
    Complex alone_law_;
    Test test_{};
    double angle_ = 0.5 * kPi, cosine_ = std::cos(angle_), sine_ = std::sin(angle_);
    std::vector<double> law_bends_, missed_, law_missed_;  // `law_missed_`: as `missed_`, of Tᵀ D T
    std::vector<double> trial_, vector_;

    // From where the last interval has ended to `high`.
    void run(double high, double floor, std::int64_t most, std::vector<Interval>& undecided) {
        int free[kDepth + 2], stack[kDepth + 2], depth = 0, spare = 0;
        for (int k = 0; k < kDepth + 2; k++)
            if (k != left_) free[spare++] = k;
        stack[0] = free[--spare];
        sample(nodes_[stack[0]], high);
        while (depth >= 0) {
            const int right = stack[depth];
            const double a = nodes_[left_].omega, b = nodes_[right].omega;
            const bool decided = samples_ < most && excluded(nodes_[left_], nodes_[right]);
            if (!decided && b - a > floor * b && spare > 0 && samples_ < most) {
                const int middle = free[--spare];
                sample(nodes_[middle], b > 1.5 * a ? std::sqrt(a * b) : 0.5 * (a + b));
                if ((mixed() && !whole()) || b - a > kCoarse * b || excluded(nodes_[middle], nodes_[middle])) {
                    stack[++depth] = middle;
                    continue;
                }
                free[spare++] = middle;  // not even by itself: nothing is gained by halving
            }
            if (!decided)
                add(undecided, a, b);
            else if (counting_)
                turned += argument(nodes_[right], angle_) - argument(nodes_[left_], angle_);
            free[spare++] = left_;
            left_ = right;
            depth--;
        }
    }

    // True where Re(j d_i) > 0 for all i and all of [low, high].
    bool leads(double low, double high) const {
        const Cell cell(low, high, loop_.step, loop_.inexact);
        ModalLoop::Place at_start = loop_.place(low), at_end = loop_.place(high);
        for (std::size_t i = 0; i < n_; i++) {
            if (loop_.alike[i] < i) continue;
            const Complex start = loop_.inverse_law(i, at_start), end = loop_.inverse_law(i, at_end);
            const double size =
                std::max(ModalLoop::inverse_law_size(start, cell.a, cell.step), ModalLoop::inverse_law_size(end, cell.b, cell.step));
            const double bend = loop_.inverse_law_bend(i, cell, size);
            if (!(-std::max(start.imag(), end.imag()) > bend)) return false;
        }
        return true;
    }

    // The change of arg det F over an interval in which j F has a positive real part throughout.
    double turned_leading(double low, double high) {
        if (!counting_) return 0.0;
        align(low, high);
        sample(nodes_[0], low);
        sample(nodes_[1], high);
        return argument(nodes_[1], 0.5 * kPi) - argument(nodes_[0], 0.5 * kPi);
    }

    bool too_small(const Node& left, const Node& right) {
        const Cell cell(left.omega, right.omega, loop_.step, loop_.inexact);
        sum_.missed_rows(cell, vector_.data());
        for (std::size_t i = 0; i < n_; i++) {
            double row = vector_[i];
            for (std::size_t j = 0; j < n_; j++) row += std::max(entry(left, i, j), entry(right, i, j));
            const double least = loop_.least_inverse_law(i, cell, std::min(left.size[i], right.size[i])) * std::norm(scale_[i]);
            if (!(row * (1 + kSafe) < v_ * least)) return false;
        }
        return true;
    }

    // |Q_ij|
    double entry(const Node& node, std::size_t i, std::size_t j) const {
        const std::size_t at = std::min(i, j) * stride_ + std::max(i, j);
        const Complex value(node.real[at], node.imaginary[at]);
        return size_of(i == j ? value - v_ * node.law[i] : value);
    }

    // What interpolation between two nodes may miss: `missed_` of Q (upper triangle), `law_bends_` of d; of one node only round-off.
    void bound(const Node& left, const Node& right) {
        const bool one = &left == &right;
        const Cell cell(left.omega, right.omega, loop_.step, loop_.inexact);
        if (one)
            std::fill(missed_.begin(), missed_.end(), 0.0);
        else
            sum_.missed(cell, missed_.data());
        double most = 0.0;
        if (!one) loop_.inverse_law_bends(cell, left.size.data(), right.size.data(), law_bends_.data());
        for (std::size_t i = 0; i < n_; i++) {
            law_bends_[i] = one ? 0.0 : law_bends_[i] * std::norm(scale_[i]);
            most = std::max(most, law_bends_[i]);
        }
        most *= mixing_size_;
        const double rounding = kRounding * static_cast<double>(n_);
        for (std::size_t i = 0; i < n_; i++) {
            missed_[i * stride_ + i] += rounding * (size_of(left.law[i]) + size_of(right.law[i])) + std::max(left.round_off[i], right.round_off[i]);
            missed_[i * stride_ + i] += v_ * (mixed() ? most : law_bends_[i]);
            if (mixed()) law_missed_[i * stride_ + i] = most + rounding * mixing_size_;
        }
    }

    bool excluded(const Node& left, const Node& right) {
        bound(left, right);  // then one angle serves both ends, with what interpolation misses to spare
        double low = angle_ - kPi, high = angle_ + kPi;
        for (int cut = 0; cut < kCuts; cut++) {
            if (!(high - low > 1e-12)) return false;
            if (cut > 0 || !(low < angle_ && angle_ < high)) {
                angle_ = 0.5 * (low + high);
                cosine_ = std::cos(angle_);
                sine_ = std::sin(angle_);
            }
            if (holds(right) && holds(left)) return true;
            if (!cut_off(low, high)) return false;
        }
        return false;
    }

    // True where the angle serves one node; else `test_` has failed there, with `vector_` or `alone_` to show it.
    bool holds(const Node& node) {
        const bool from_rest = more_ < 0;
        alone_ = n_;
        bool law = true;
        if (mixed()) {
            test_ = {node.law_real.data(), node.law_imaginary.data(), law_missed_.data()};
            law = positive(test_);
        } else {
            for (std::size_t i = 0; i < n_ && law; i++) {
                const Complex own = node.law[i];
                law = cosine_ * own.real() - sine_ * own.imag() > law_bends_[i];
                if (!law && from_rest) {
                    alone_ = i;
                    alone_law_ = own;
                }
            }
        }
        if (!law && from_rest) return false;
        test_ = {node.real.data(), node.imaginary.data(), missed_.data()};
        if (!positive(test_)) return false;
        if (law) return true;
        test_.node = &node;
        test_.more = more_;
        return positive(test_);
    }

    // What `test` asks to be positive: entry (i, j) of the real part, of the imaginary part, and of what may be missed.
    void entries(const Test& test, std::size_t i, std::size_t j, double& real, double& imaginary, double& missed) const {
        const std::size_t at = i * stride_ + j;
        real = test.real[at];
        imaginary = test.imaginary[at];
        missed = test.missed[at];
        if (test.node == nullptr) return;
        if (mixed()) {
            real += test.more * test.node->law_real[at];
            imaginary += test.more * test.node->law_imaginary[at];
            missed += test.more * law_missed_[at];
        } else if (i == j) {
            real += test.more * test.node->law[i].real();
            imaginary += test.more * test.node->law[i].imag();
            missed += test.more * (law_bends_[i] + kRounding * static_cast<double>(n_) * size_of(test.node->law[i]));
        }
    }

    // Cholesky's factorisation; where it fails, `vector_` is an x with xᵀMx <= 0. Rows begin at whole fours, with what is not read.
    GAINROOM_WIDE bool positive(const Test& test) {
        for (std::size_t k = 0; k < n_; k++)
            for (std::size_t j = k / 4 * 4; j < stride_; j += 4) {
                const std::size_t at = k * stride_ + j;
                if (test.node == nullptr) {
                    put(&trial_[at], cosine_ * four(test.real + at) - sine_ * four(test.imaginary + at) - four(test.missed + at));
                } else {
                    for (std::size_t l = 0; l < 4; l++) {
                        double real, imaginary, missed;
                        entries(test, k, j + l, real, imaginary, missed);
                        trial_[at + l] = cosine_ * real - sine_ * imaginary - missed;
                    }
                }
            }
        for (std::size_t k = 0; k < n_; k++) {
            double* row = &trial_[k * stride_];
            if (!(row[k] > 0)) {
                std::fill(vector_.begin(), vector_.end(), 0.0);
                vector_[k] = 1.0;
                for (std::size_t i = k; i-- > 0;) {
                    for (std::size_t j = i + 1; j <= k; j++) vector_[i] -= trial_[i * stride_ + j] * vector_[j];
                    vector_[i] *= trial_[i * stride_ + i];
                }
                return false;
            }
            const double inverse = 1 / std::sqrt(row[k]);
            for (std::size_t j = k / 4 * 4; j < stride_; j += 4) put(row + j, inverse * four(row + j));
            for (std::size_t i = k + 1; i < n_; i++)
                if (const std::size_t first = i / 4 * 4; row[i] != 0)
                    subtract_fours(&trial_[i * stride_ + first], row[i], row + first, stride_ - first);
            row[k] = inverse;  // of the pivot
        }
        return true;
    }

    // Leaves the angles at which what has failed may hold; false where there is none.
    bool cut_off(double& low, double& high) {
        double cosine = 0.0, sine = 0.0, needed = 0.0;
        if (alone_ < n_) {
            cosine = alone_law_.real();
            sine = -alone_law_.imag();
            needed = law_bends_[alone_];
        } else {
            for (std::size_t i = 0; i < n_; i++)
                for (std::size_t j = i; j < n_ && vector_[i] != 0; j++) {
                    const double product = (j > i ? 2.0 : 1.0) * vector_[i] * vector_[j];
                    double real, imaginary, missed;
                    entries(test_, i, j, real, imaginary, missed);
                    cosine += product * real;
                    sine -= product * imaginary;
                    needed += product * missed;
                }
        }
        const double size = std::hypot(cosine, sine);
        if (!(size > needed)) return false;
        narrow(low, high, std::atan2(sine, cosine), std::acos(std::clamp(needed / size, -1.0, 1.0)));
        return true;
    }

    // (low, high) within `half` of the angle `middle`, the turn of it that is nearest.
    static void narrow(double& low, double& high, double middle, double half) {
        const double near = middle + 2 * kPi * std::round((0.5 * (low + high) - middle) / (2 * kPi));
        low = std::max(low, near - half);
        high = std::min(high, near + half);
    }

    static void add(std::vector<Interval>& to, double low, double high) {
        if (!to.empty() && to.back().high == low)
            to.back().high = high;
        else
            to.push_back({low, high});
    }
};

}  // namespace gainroom
