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
// Gains that couple joints need not leave F (r, r) symmetric. Then F₂ = [½(F + Fᵀ), ½j(F − Fᵀ); −½j(F − Fᵀ), ½(F + Fᵀ)], which is, takes its
// place (`twofold`): aᵀ and bᵀ of x = a + jb make x̄ᵀ F x of it, so that Re F₂ > 0 where F + Fᴴ > 0, and det F₂ = det(F)². Its vectors at a
// root, of yᵀ F = 0 and F x = 0, are z = ½(y + x, j(y − x)) and the same with y → jy, x → −jx.
#pragma once

#include <cstdint>

#include "mixing.hpp"
#include "mode_sum.hpp"

namespace gainroom {

struct Interval {
    double low, high;
};

class Exclusion {
   public:
    double turned = 0.0;  // arg det F over what was excluded, at the factor 1, which has to be between; only where `counting`

    // Factors from `from`, 0: from rest, to `gain`. `alignment`: part of the joints' phase differences that is turned away beforehand, 0 to 1.
    // `crossing`: X (count, n).
    Exclusion(const ModalLoop& loop, double from, double gain, double alignment, bool counting = false, const Complex* crossing = nullptr,
              std::size_t crossing_count = 0)
        : loop_(loop),
          sum_(loop),
          crossing_(crossing, crossing + crossing_count * loop.size),
          v_(1 / gain),
          more_(from > 0 ? 1 / from - 1 / gain : -1.0),
          counting_(counting),
          alignment_(alignment),
          n_(loop.size),
          stride_(sum_.stride) {
        scale_.resize(n_);
        law_bends_.resize(n_);
        missed_.resize(n_ * stride_);
        trial_.resize(n_ * stride_);
        vector_.resize(n_);
        if (mixed()) law_missed_.resize(n_ * stride_);
        if (counting) pivots_.resize(n_ * n_);
    }

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

    struct Node {
        double omega = 0.0;
        std::vector<double> real, imaginary;  // upper triangle of Q + v D, aligned and scaled
        std::vector<Complex> law;             // d_i, likewise
        std::vector<double> size;             // |1/c_i|
        std::vector<double> round_off;        // of Q, as a diagonal matrix
        std::vector<double> law_real, law_imaginary;  // upper triangle of Tᵀ D T, where unknowns are mixed
        std::vector<Complex> pivots;  // of F at the factor 1; empty until asked for
        void resize(std::size_t n, std::size_t stride, bool mixed) {
            real.resize(n * stride);
            imaginary.resize(n * stride);
            law.resize(n);
            size.resize(n);
            round_off.resize(n);
            law_real.resize(mixed ? n * stride : 0);
            law_imaginary.resize(mixed ? n * stride : 0);
            pivots.clear();
        }
    };

    // A matrix that has to be positive, less what may be missed: of Re(e^{jθ} (real + j imaginary)) and, `more` times, of Re(e^{jθ} D).
    struct Test {
        const double *real, *imaginary, *missed;
        const Node* node = nullptr;
        double more = 0.0;
    };

    const ModalLoop& loop_;
    ModeSum sum_;
    std::vector<Complex> crossing_, mixing_;  // X (count, n), T (n, n)
    std::vector<double> law_missed_;          // as `missed_`, of Tᵀ D T
    double mixing_size_ = 1.0;                // bound of |T|²
    double v_, more_;  // w - v; < 0: w = ∞
    bool counting_;
    double alignment_;
    std::size_t n_, stride_;
    std::vector<Complex> pivots_;
    Node nodes_[kDepth + 2];
    int left_ = 0;  // the node where the next interval begins
    std::int64_t samples_ = 0;
    std::size_t alone_ = 0;  // the joint whose d_i has failed; n: the whole matrix
    Test test_{};
    double angle_ = 0.5 * kPi;
    std::vector<Complex> scale_;
    std::vector<double> law_bends_, missed_, trial_, vector_;

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
                if (mixed() || b - a > kCoarse * b || excluded(nodes_[middle], nodes_[middle])) {
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
        for (std::size_t i = 0; i < n_; i++) {
            if (loop_.alike[i] < i) continue;
            const Complex start = loop_.inverse_law(i, cell.a), end = loop_.inverse_law(i, cell.b);
            const double size =
                std::max(ModalLoop::inverse_law_size(start, cell.a, cell.step), ModalLoop::inverse_law_size(end, cell.b, cell.step));
            if (!(-std::max(start.imag(), end.imag()) > loop_.inverse_law_bend(i, cell, size))) return false;
        }
        return true;
    }

    // How arg det F changes where j F has a positive real part all the way.
    double turned_leading(double low, double high) {
        if (!counting_) return 0.0;
        align(low, high);
        sample(nodes_[0], low);
        sample(nodes_[1], high);
        return argument(nodes_[1], 0.5 * kPi) - argument(nodes_[0], 0.5 * kPi);
    }

    // Σ arg(e^{jθ} p_i)
    double argument(Node& node, double angle) {
        double sum = 0.0;
        const Complex turn = std::polar(1.0, angle);
        for (const Complex pivot : pivots(node)) sum += std::arg(times(turn, pivot));
        return sum;
    }

    // arg det(I + L) where that is near I: the pivots of D⁻¹F are p_i/d_i.
    double argument_of_loop(Node& node) {
        double sum = 0.0;
        for (std::size_t i = 0; i < n_; i++) sum += std::arg(over(pivots(node)[i], node.law[i]));
        return sum;
    }

    // Of Q + D, by Gauss without exchanges.
    const std::vector<Complex>& pivots(Node& node) {
        if (!node.pivots.empty()) return node.pivots;
        pivots_.resize(n_ * n_);
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = i; j < n_; j++) {
                const std::size_t at = i * stride_ + j;
                Complex law = 0.0;
                if (mixed())
                    law = {node.law_real[at], node.law_imaginary[at]};
                else if (i == j)
                    law = node.law[i];
                pivots_[i * n_ + j] = Complex(node.real[at], node.imaginary[at]) + (1 - v_) * law;
            }
        for (std::size_t k = 0; k < n_; k++) {
            node.pivots.push_back(pivots_[k * n_ + k]);
            for (std::size_t i = k + 1; i < n_; i++) {
                const Complex factor = over(pivots_[k * n_ + i], pivots_[k * n_ + k]);
                if (factor == 0.0) continue;
                for (std::size_t j = i; j < n_; j++) pivots_[i * n_ + j] -= times(factor, pivots_[k * n_ + j]);
            }
        }
        return node.pivots;
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

    // Units in which every d_i has size 1 in the middle, and as much of a common phase as is asked for: a congruence.
    void align(double low, double high) {
        const double middle = std::sqrt(low * high);
        Complex mean = 0.0;
        loop_.inverse_laws(middle, scale_.data());
        for (std::size_t i = 0; i < n_; i++) mean += scale_[i] / std::abs(scale_[i]);
        for (std::size_t i = 0; i < n_; i++) {
            const double turn = alignment_ == 0 ? 0.0 : 0.5 * alignment_ * turn_between(scale_[i], mean);
            scale_[i] = std::polar(1 / std::sqrt(std::abs(scale_[i])), turn);
        }
        if (alignment_ == 0 && !mixed()) {
            std::vector<double> units(n_);
            for (std::size_t i = 0; i < n_; i++) units[i] = scale_[i].real();
            sum_.set_units(units);
            return;
        }
        std::vector<Complex> rigid(n_ * n_), shapes(loop_.modes * n_);
        for (std::size_t k = 0; k < loop_.modes; k++)
            for (std::size_t i = 0; i < n_; i++) shapes[k * n_ + i] = times(scale_[i], loop_.shapes[k * n_ + i]);
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j < n_; j++) rigid[i * n_ + j] = times(times(scale_[i], scale_[j]), loop_.rigid_at(i * n_ + j));
        std::vector<double> rigid_made_of(n_), made_of(loop_.modes * n_);
        if (mixed()) {
            mix(rigid, shapes, rigid_made_of, made_of);
        } else {
            for (std::size_t k = 0; k < made_of.size(); k++) made_of[k] = size_of(shapes[k]);
            for (std::size_t k = 0; k < rigid.size(); k++) rigid_made_of[k / n_] += size_of(rigid[k]);
        }
        sum_.set_coordinates(rigid, shapes, rigid_made_of, made_of);
    }

    bool mixed() const { return !crossing_.empty(); }

    // T, and what it makes of M₀ and of the modes; with the sizes of what is summed up.
    void mix(std::vector<Complex>& rigid, std::vector<Complex>& shapes, std::vector<double>& rigid_made_of, std::vector<double>& made_of) {
        mixing_ = mixing_of(crossing_, scale_, mixing_size_);
        std::vector<double> sizes(n_ * n_), rows(n_, 0.0), across(n_, 0.0);
        for (std::size_t k = 0; k < n_ * n_; k++) sizes[k] = size_of(mixing_[k]);
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j < n_; j++) rows[i] += sizes[i * n_ + j];
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j < n_; j++) across[i] += size_of(rigid[i * n_ + j]) * rows[j];
        for (std::size_t j = 0; j < n_; j++)
            for (std::size_t i = 0; i < n_; i++) {
                rigid_made_of[j] += sizes[i * n_ + j] * across[i];
                for (std::size_t k = 0; k < loop_.modes; k++) made_of[k * n_ + j] += size_of(shapes[k * n_ + i]) * sizes[i * n_ + j];
            }
        std::vector<Complex> row(n_), half(n_ * n_);
        for (std::size_t k = 0; k < loop_.modes; k++) {
            for (std::size_t j = 0; j < n_; j++) row[j] = mixed_row(&shapes[k * n_], j);
            std::copy(row.begin(), row.end(), &shapes[k * n_]);
        }
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j < n_; j++) half[j * n_ + i] = mixed_row(&rigid[i * n_], j);  // (M T)ᵀ
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j < n_; j++) rigid[j * n_ + i] = mixed_row(&half[i * n_], j);
    }

    // Σ_i row_i T_ij
    Complex mixed_row(const Complex* row, std::size_t j) const {
        Complex value = 0.0;
        for (std::size_t i = 0; i < n_; i++)
            if (row[i] != 0.0) value += times(row[i], mixing_[i * n_ + j]);
        return value;
    }

    void sample(Node& node, double omega) {
        samples_++;
        node.resize(n_, stride_, mixed());
        node.omega = omega;
        sum_.respond(omega, node.real.data(), node.imaginary.data(), node.round_off.data());
        loop_.inverse_laws(omega, node.law.data());
        for (std::size_t i = 0; i < n_; i++) {
            node.size[i] = ModalLoop::inverse_law_size(node.law[i], omega, loop_.step);
            node.law[i] = times(node.law[i], times(scale_[i], scale_[i]));
            if (!mixed()) {
                node.real[i * stride_ + i] += v_ * node.law[i].real();
                node.imaginary[i * stride_ + i] += v_ * node.law[i].imag();
            }
        }
        if (!mixed()) return;
        std::fill(node.law_real.begin(), node.law_real.end(), 0.0);
        std::fill(node.law_imaginary.begin(), node.law_imaginary.end(), 0.0);
        for (std::size_t k = 0; k < n_; k++)
            for (std::size_t i = 0; i < n_; i++) {
                const Complex left = times(node.law[k], mixing_[k * n_ + i]);
                if (left == 0.0) continue;
                for (std::size_t j = i; j < n_; j++) {
                    const Complex value = times(left, mixing_[k * n_ + j]);
                    node.law_real[i * stride_ + j] += value.real();
                    node.law_imaginary[i * stride_ + j] += value.imag();
                }
            }
        add(v_, node.law_real.data(), node.real.data(), 0, n_ * stride_);
        add(v_, node.law_imaginary.data(), node.imaginary.data(), 0, n_ * stride_);
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

    // True where one angle serves both ends, with what interpolation misses to spare.
    bool excluded(const Node& left, const Node& right) {
        bound(left, right);
        double low = angle_ - kPi, high = angle_ + kPi;
        for (int cut = 0; cut < kCuts; cut++) {
            if (!(high - low > 1e-12)) return false;
            if (cut > 0 || !(low < angle_ && angle_ < high)) angle_ = 0.5 * (low + high);
            const Node* failed = nullptr;
            for (const Node* node : {&right, &left}) {
                if (!holds(*node)) {
                    failed = node;
                    break;
                }
            }
            if (failed == nullptr) return true;
            if (!cut_off(*failed, low, high)) return false;
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
            const double c = std::cos(angle_), s = std::sin(angle_);
            for (std::size_t i = 0; i < n_ && law; i++) {
                law = c * node.law[i].real() - s * node.law[i].imag() > law_bends_[i];
                if (!law && from_rest) alone_ = i;
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

    // Cholesky's factorisation; where it fails, `vector_` is an x with xᵀMx <= 0.
    bool positive(const Test& test) {
        const double c = std::cos(angle_), s = std::sin(angle_);
        for (std::size_t k = 0; k < n_; k++)
            for (std::size_t j = k; j < n_; j++) {
                const std::size_t at = k * stride_ + j;
                if (test.node == nullptr) {
                    trial_[at] = c * test.real[at] - s * test.imaginary[at] - test.missed[at];
                } else {
                    double real, imaginary, missed;
                    entries(test, k, j, real, imaginary, missed);
                    trial_[at] = c * real - s * imaginary - missed;
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
            for (std::size_t j = k + 1; j < n_; j++) row[j] *= inverse;
            for (std::size_t i = k + 1; i < n_; i++)
                if (row[i] != 0) add(-row[i], row, &trial_[i * stride_], i, n_);
            row[k] = inverse;  // of the pivot
        }
        return true;
    }

    // to_j += factor from_j for first <= j < end.
    static void add(double factor, const double* __restrict from, double* __restrict to, std::size_t first, std::size_t end) {
        for (std::size_t j = first; j < end; j++) to[j] += factor * from[j];
    }

    // Leaves the angles at which what has failed may hold; false where there is none.
    bool cut_off(const Node& node, double& low, double& high) {
        double cosine = 0.0, sine = 0.0, needed = 0.0;
        if (alone_ < n_) {
            cosine = node.law[alone_].real();
            sine = -node.law[alone_].imag();
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
