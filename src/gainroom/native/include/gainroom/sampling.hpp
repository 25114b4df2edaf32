// Exact sampling of a scalar transfer function behind a zero-order hold and a fraction of a tick of delay.
//
// With G(s) = Σ r_i/(s − p_i), a torque that is u_{k−1} for the first f T_s of a tick and u_k for the rest gives
//
//   G(z) = Σ r_i (b_i z + c_i) / (z (z − E_i)),
//   E_i = e^{p_i T_s},  b_i = (e^{p_i (1−f) T_s} − 1)/p_i,  c_i = (E_i − e^{p_i (1−f) T_s})/p_i.
//
// The numerator is a small difference of large terms (a plant that falls off as 1/s⁵ loses 15 digits at 2 kHz), so it is formed in extended
// precision; its zeros are then good to the last digit of a double.
#pragma once

#include <vector>

#include "extended.hpp"
#include "factors.hpp"
#include "response.hpp"

namespace gainroom {

constexpr double kPolesApart = 1e-22;  // of 1/T_s: coinciding poles (the two integrators among them) are moved apart, far below a double
constexpr double kLargestExponent = 1e12;  // |p T_s|: each doubling beyond 2^−16 costs a bit of the 320
constexpr std::size_t kMostPoles = 60;
constexpr double kFarthest = 1e-20;    // a zero at |z| beyond 1/kFarthest changes no digit of the response: its factor is a constant

inline Complex rounded(Complex value) { return value; }
inline Complex rounded(const ExtendedComplex& value) { return value.to_double(); }

// One step of all roots of a monic polynomial, highest power first, by Newton's method (Weierstrass, Durand and Kerner): each x_i by
// p(x_i)/Π_{j≠i}(x_i − x_j). Returns the largest step, relative to its root. Discs of n such steps around the x_i hold all roots, as many
// as they have centres (Gerschgorin), so that small steps prove that no root is missing.
template <typename Number>
double step_roots(const std::vector<Number>& monic, std::vector<Number>& roots, std::vector<Complex>& steps) {
    double largest = 0.0;
    for (std::size_t i = 0; i < roots.size(); i++) {
        Number value = monic[0];
        for (std::size_t k = 1; k < monic.size(); k++) value = value * roots[i] + monic[k];
        const double size = std::abs(rounded(roots[i])) + 1e-30;
        steps[i] = rounded(value);
        for (std::size_t j = 0; j < roots.size(); j++) {
            if (j == i) continue;
            const Complex apart = rounded(roots[i] - roots[j]);
            steps[i] = over(steps[i], apart == 0.0 ? Complex(1e-9 * size) : apart);
        }
        largest = std::max(largest, std::abs(steps[i]) / size);
    }
    for (std::size_t i = 0; i < roots.size(); i++) roots[i] = roots[i] - Number(steps[i]);
    return largest;
}

// All roots of a real polynomial, highest power first, to 30 digits or so; none where the steps do not become small.
inline std::vector<ExtendedComplex> roots_of(const std::vector<Extended>& polynomial) {
    constexpr int kMostRough = 60, kMostSteps = 400;
    constexpr double kRough = 1e-9, kSmall = 1e-18;  // the step after a small one is of the order of its square
    const std::size_t count = polynomial.size() - 1;
    const Extended scale = polynomial[0].inverse();
    std::vector<ExtendedComplex> monic;
    std::vector<Complex> rough;
    std::vector<double> logs;
    for (const Extended& coefficient : polynomial) {
        monic.emplace_back(coefficient * scale);
        rough.push_back(monic.back().to_double());
        logs.push_back(log_size(rough.back()));
    }
    // Starts as far out as the upper hull of log|a_k| says (Bini 1996), at angles without symmetry.
    std::vector<Complex> starts, steps(count);
    for (std::size_t k = 0, next = 0; k < count; k = next) {
        next = k + 1;
        for (std::size_t j = k + 2; j <= count; j++)
            if ((logs[j] - logs[k]) / static_cast<double>(j - k) >= (logs[next] - logs[k]) / static_cast<double>(next - k)) next = j;
        const double radius = std::exp((logs[next] - logs[k]) / static_cast<double>(next - k));
        for (std::size_t j = k; j < next; j++)
            starts.push_back(std::polar(radius, 2 * kPi * static_cast<double>(j) / static_cast<double>(next - k) + 0.7));
    }
    for (int step = 0; step < kMostRough; step++)
        if (!(step_roots(rough, starts, steps) > kRough)) break;
    std::vector<ExtendedComplex> roots;
    for (const Complex start : starts) {
        if (!std::isfinite(std::abs(start))) return {};
        roots.emplace_back(start);
    }
    for (int step = 0; step < kMostSteps; step++)
        if (step_roots(monic, roots, steps) < kSmall) return roots;
    return {};
}

// A continuous, strictly proper transfer function, to be sampled at any fraction of a tick of delay.
class Sampler {
   public:
    // Poles closed under conjugation.
    Sampler(const Complex* zero, std::size_t zero_count, const Complex* pole, std::size_t pole_count, double gain, double sample_time)
        : step_(sample_time), poles_(pole, pole + pole_count) {
        const double largest = largest_of(zero, zero_count) + largest_of(pole, pole_count);
        sound_ = sample_time > 0 && std::isfinite(gain) && largest * sample_time < kLargestExponent && pole_count <= kMostPoles &&
                 zero_count < pole_count;
        if (!sound_) return;
        const Extended tick(sample_time), least = Extended(kPolesApart) / tick;
        std::vector<ExtendedComplex> places, grown;
        for (const Complex given : poles_) {
            ExtendedComplex place(given);
            const auto coincides = [&](const ExtendedComplex& other) {
                return std::abs((place - other).to_double()) * sample_time < kPolesApart;
            };
            while (std::any_of(places.begin(), places.end(), coincides)) place.real = place.real + least;
            places.push_back(place);
            grown.push_back(exponential(place * tick));
        }
        std::vector<ExtendedComplex> all{Extended(1.0)};
        for (const ExtendedComplex& factor : grown) {
            all.emplace_back();
            for (std::size_t k = all.size() - 1; k > 0; k--) all[k] = all[k] - factor * all[k - 1];
        }
        for (std::size_t i = 0; i < pole_count; i++) {
            if (poles_[i].imag() < 0) continue;
            ExtendedComplex residue{Extended(gain)}, apart{Extended(1.0)};
            for (std::size_t j = 0; j < zero_count; j++) residue = residue * (places[i] - ExtendedComplex(zero[j]));
            for (std::size_t j = 0; j < pole_count; j++)
                if (j != i) apart = apart * (places[i] - places[j]);
            std::vector<ExtendedComplex> others{all[0]};  // Π_{j≠i} (z − E_j)
            for (std::size_t k = 1; k < pole_count; k++) others.push_back(all[k] + grown[i] * others[k - 1]);
            parts_.push_back({places[i], grown[i], residue / apart, std::move(others), poles_[i].imag() > 0 ? 2.0 : 1.0});
        }
    }

    // Sampled with `fraction` in [0, 1) of a tick of delay; no poles where it cannot be: for what is not finite, not strictly proper, or
    // faster than 1e12 radians a tick.
    Factors at(double fraction) const {
        if (!sound_ || !(fraction >= 0 && fraction < 1)) return {};
        const bool late = fraction > 0;
        const Extended tick(step_), rest = Extended(1.0) - Extended(fraction);
        std::vector<Extended> numerator(poles_.size() + late);
        for (const Part& part : parts_) {
            ExtendedComplex now(tick * rest), before(tick * Extended(fraction));
            const bool moves = !(part.pole.real.is_zero() && part.pole.imag.is_zero());
            if (moves) {
                const ExtendedComplex partial = late ? exponential(part.pole * (tick * rest)) : part.grown;
                const ExtendedComplex inverse = ExtendedComplex(Extended(1.0)) / part.pole;
                now = (partial - ExtendedComplex(Extended(1.0))) * inverse;
                before = (part.grown - partial) * inverse;
            }
            now = now * part.residue * Extended(part.share), before = before * part.residue * Extended(part.share);
            for (std::size_t k = 0; k < part.others.size(); k++) {
                numerator[k] = numerator[k] + real_part(part.others[k], now);
                if (late) numerator[k + 1] = numerator[k + 1] + real_part(part.others[k], before);
            }
        }
        // A delay just under a whole tick has a zero next to infinity.
        while (numerator.size() > 1 && is_next_to_nothing(numerator[0], numerator[1])) numerator.erase(numerator.begin());
        Factors found;
        const std::vector<ExtendedComplex> roots = roots_of(numerator);
        if (numerator[0].is_zero() || roots.size() + 1 != numerator.size()) return {};
        const Extended rate = tick.inverse();
        Extended gain = numerator[0];
        for (std::size_t k = roots.size(); k < poles_.size() + late; k++) gain = gain * rate;
        found.gain = gain.to_double();
        for (const ExtendedComplex& root : roots) add_zero(((root - ExtendedComplex(Extended(1.0))) * rate).to_double(), found.zeros);
        for (const Complex pole : poles_) found.poles.push_back(variable(pole, step_));
        if (late) found.poles.emplace_back(-1 / step_);
        const bool finite = std::isfinite(found.gain + largest_of(found.zeros.data(), found.zeros.size()) +
                                          largest_of(found.poles.data(), found.poles.size()));
        return finite ? found : Factors{};
    }

   private:
    struct Part {
        ExtendedComplex pole, grown, residue;
        std::vector<ExtendedComplex> others;
        double share;  // a conjugate's part adds the same real part once more
    };

    double step_;
    std::vector<Complex> poles_;
    std::vector<Part> parts_;
    bool sound_ = false;

    // Infinite where one is not finite.
    static double largest_of(const Complex* roots, std::size_t count) {
        double largest = 0.0;
        for (std::size_t k = 0; k < count; k++) {
            const double size = std::abs(roots[k]);
            largest = std::isfinite(size) ? std::max(largest, size) : kInfinite;
        }
        return largest;
    }

    static Extended real_part(const ExtendedComplex& a, const ExtendedComplex& b) { return a.real * b.real - a.imag * b.imag; }

    static bool is_next_to_nothing(const Extended& first, const Extended& second) {
        return first.is_zero() || std::fabs((first / second).to_double()) < kFarthest;
    }

    // Exactly closed under conjugation.
    static void add_zero(Complex place, std::vector<Complex>& zeros) {
        if (std::fabs(place.imag()) <= 1e-14 * std::abs(place)) {
            zeros.emplace_back(place.real());
        } else if (place.imag() > 0) {
            zeros.push_back(place);
            zeros.push_back(std::conj(place));
        }
    }
};

}  // namespace gainroom
