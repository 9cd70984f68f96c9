"""The embedded default simulator: scenes behind a flat port, a laser, a swaying vehicle, and the truth of all of it.

``SimulatedDive(scenario, seed)`` gives samples in the order of their arrival; ``scenario.py`` lists what can be set,
``scenarios/*.yaml`` are examples. ``pictures.random_picture`` makes single training pictures for a detector.

Exact: the geometry. Each pixel's ray goes through the port as the rig has it; hits, limbs, the spot, nearest points and
velocities follow from it, and both cameras see the same particles, texture and light. Modelled, in the manner of the
literature: attenuation, backscatter, forward scatter, lamps, caustics, defocus, exposure, noise. Left out: shadows, the
water's own motion, sensor mosaic and compression, and blur by growing (motion blurs a surface as a whole, sideways).
"""
