"""Stability, margins, limits and gain regions of a loop, certified.

Margins        margins (of one joint, and the entry for all), boundary (of several joints, from samples in the core), margin_record
               (what all give), disk_margin, _disk_modes and _mu (all at once, independently); multirate (kd on a path of its own), with
               peak_gain (over the unit circle); margins_outside (without bands of frequencies)
Delay margin   of one joint in margins; of coupled loops in boundary
Gain limits    gain_limit, by proof or from samples; proved: proved_limit, by modal_loop, proof_at_rest and followed_root; of a part of the
               gains: boundary, gain_directions; limbs
Stability      stability (roots), stability_boundary (where s or z runs along it)
Modes          equal_modes (of limbs that vibrate at the same limit)
Frequencies    crossings (of one joint, certified between points), sampled_scan (of callables)
Gain regions   gain_region of one joint, from gain_plane and excluded_region; of a part of coupled gains: part_plane, part_requirements,
               other_loops, common_phase_plane, every_loop
Ranges         range_proof and box_loops: every joint whose parameters lie in ranges
Sampled loops  sampled_loop: a loop with its gains as the core has it, by look
Searches       look: all of this of coupled loops in the core, sampled and not certified, in milliseconds
"""
