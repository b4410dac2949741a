"""Exposures, sensor motion and shutters to photograph moving things in dim light.

Begin with `optimise(example_scene())`; `help(name)` describes a name. All names, by purpose:

Scenes
    Scene                     speeds, light, noise and limits; its `load` and `save` are of a file
    example_scene             the built-in scene
    read_scene                a scene from a TOML file
    View                      size of things in the picture: speeds in m/s, mm/s or degrees
    read_noise_from_dynamic_range  read noise from a data sheet
    Texture                   statistics of pictures, and the photograph to show results on
    Optics                    what the lens passes, and how it blurs
    Sensor                    what a pixel holds, and the width and the axis of the sensor
    Limits                    limits of the stage and of the exposure
    Tolerances                errors of the camera as built
    MeasurementErrors         errors of measured numbers, within which a gain is stated
    Objects                   objects that are registered one by one, and their width
    Occlusion                 objects that hide part of a background
    EvenVelocities            velocities in any direction that fill a disc or an ellipse
    RingOfVelocities          one speed in any direction
    ListedVelocities          velocities one by one
    BurstMode                 frames that a camera may take instead of one exposure

Designs and their rivals
    optimise                  searches for the best design for a scene
    compare                   designs, snapshots, windows, stills and bursts; the answer
    Design                    exposures for a scene, their quality and their file
    OneExposure               what it has of one: shutter, motion, and how they were found
    plot_design               draws a design: its shutter, its path and its frames in time
    Comparison                what `compare` returns: rows, verdict and gain
    evaluate                  metrics of a design
    Metrics                   what `evaluate` returns
    ceiling                   the PSNR that no path, shutter or linear decoder exceeds
    tolerance_costs           the cost of each tolerance to a design
    best_sequence             the frames to take of a camera with a `BurstMode`
    best_in_plane             the frames to take of things that move in any direction
    PlaneSearch               what it returns: the best frames of each kind of way
    PlaneDesign               the former name of a `Design` of them
    PlaneFrames               frames and a path in the plane
    exposures_psnr            level of frames along an axis or in the plane, with derivatives
    Exposures                 what `best_sequence` returns: frames, their path and their level
    TimedFrame                one of its frames: motion, time and place
    starting_shutter          the free-form profile that a search starts from
    DesignParameters          designs within the limits, for your own optimisers
    ExposureParameters        frames within the limits, for the same
    keep_compiled_programs    keeps what is compiled for later sessions
    Outcome                   how a search ended
    SearchFailedError         a search with `throw=True` did not converge
    NonFiniteLossError        a loss was not finite where a search had to know it

Losses
    ExpectedErrorLoss         error of the restored picture, by one filter for all speeds
    WorstSpeedLoss            the same at the worst of the speeds
    KnownSpeedLoss            by a filter that knows the speed
    FoundSpeedLoss            by a decoder that finds the speed in the picture
    DesignLoss                condition number, kernel difference and lost light
    AbstractLoss              a loss of your own
    AbstractResponseLoss      one that sees the shutter through its response alone, and is fast

Shutters
    RectShutter               open for the whole exposure
    HannShutter               a squared cosine
    TriangleShutter           rises and falls in straight lines
    GaussianShutter           a Gaussian, cut off at the ends
    TukeyShutter              open with cosine ramps
    ChippedShutter            equal chips of constant transmittance
    RASKAR_CODE               the 52 chips of a flutter shutter
    SplineShutter             the free-form profile that is optimised
    AbstractShutter           a shutter of your own
    AbstractPiecewiseShutter  one that is analytic between breakpoints
    register_shutter          lets designs with a shutter of your own be saved
    baselines                 the windows that every design stands beside

Devices, from the command to the transmittance
    IdealDevice               follows every command, and may lose light
    FirstOrderDevice          opens and closes gradually, as liquid crystals do
    SwitchedDevice            open or closed in each of equal slots

Motions
    ParabolicMotion           constant acceleration: the motion-invariant camera
    LinearMotion              constant velocity: a camera that pans
    StillCamera               a camera at rest
    FreeMotion                a path of piecewise constant acceleration
    stage_path                the whole path of a stage, from rest to rest
    SecondOrderStage          a stage whose servo follows as a damped oscillator

Kernels
    blur_kernel               blur of a moving point, from the vertex of its path
    centred_kernel            the same as other libraries take it
    binned_exposure           exposure between positions on the sensor
    transfer_function         response to a spatial frequency
    condition_number          largest over smallest response of a kernel

Maps
    sweep                     designs at every acceleration and exposure of a grid
    best_points               the best point under each metric
    pareto_front              points that nothing betters under several metrics
    gain_over                 gain over another shutter at the same point
    gain_over_snapshot        gain over the best snapshot
    light_map                 the best of a sweep over light and read noise
    plot_map                  draws a metric of a sweep over acceleration and exposure
    plot_front                draws two metrics of a sweep that exclude one another

Pictures
    Picture                   a picture in linear light
    example_picture           the built-in photograph
    read_picture              reads a picture into linear light
    write_picture             writes linear light as a 16-bit PNG
    row_power_spectrum        mean power spectrum of a picture's rows
    Layer                     a picture that moves, and where it is opaque
    Layers                    layers from back to front
    read_layers               reads a layered scene
    write_layers              writes a layered scene
    Footage                   frames of a video, as a subject
    read_frames               reads them from a folder or a video

Captures and their restoration
    simulate_capture          the capture of a moving picture
    restore                   restores a capture by a design
    deconvolve                restores captures by a camera in parts
    capture_and_restore       both, of any subject
    restore_photograph        both, of a photograph at several speeds
    simulate_frames           the frames of a burst, of a moving picture
    restore_frames            one picture from all of them, and its speed or velocity
    RestoredFrames            what it returns
    VelocityEstimate          the velocity that frames in the plane tell
    estimate_speed            the speed of a picture, from one capture of it
    SpeedEstimate             what it returns
    psnr                      peak signal-to-noise ratio
    EnsembleDecoder           the best linear filter for all speeds of a scene
    WienerDecoder             Wiener's filter for a still object
    TotalVariationDecoder     the likeliest picture of few edges
    RichardsonLucyDecoder     the same in counts of photons
    PlugAndPlayDecoder        a denoiser of your own in place of a prior
    SpeedFindingDecoder       finds the speed, and restores for it
    richardson_lucy           plain Richardson-Lucy along rows
    AbstractDecoder           a decoder of your own
    BlurModel                 what a decoder knows of blur, noise and pictures

In the laboratory
    drive_table               levels that come nearest to a design's profile
    DriveTable                what it returns
    frame_table               triggers of a burst's frames, and the path of the stage through them
    FrameTable                what it returns
    read_drive                reads a drive table in csv or npy
    Drive                     a drive table as it was read
    design_from_drive         the design that a drive table makes
    read_path                 reads the path of a stage as an encoder recorded it
    RecordedPath              what it returns: times and places
    with_recorded_path        a design on such a path, and how far that is from the planned one
    PathDifference            the difference
    read_trace                reads an oscilloscope's trace of a shutter
    measured_profile          the profile that a trace shows
    measure                   a scene from a clip of one's own camera: noise, velocities, texture
    Measurement               what it returns; `scene`, and `save` for its file
    fit                       the camera as built, from pictures and a trace
    FittedCamera              what it returns
    read_measurements         reads the file that lists the pictures and the trace
    TargetPicture             a picture of a point light or an edge
    SensorLevels              the conversion of electrons to levels

Folders, whose further names are for those who extend the package
    blur, camera, decoding, design, evaluation, hardware, measurement, model, pictures,
    report, search, sweeps
"""

import difflib as _difflib

import lazy_loader as _lazy

_get, __dir__, _names = _lazy.attach_stub(__name__, __file__)

__version__ = "0.2.0"


def __getattr__(name: str) -> object:
    """A public name, whose module is imported at its first use."""
    if name in _names:
        return _get(name)
    if name == "__all__":
        # With a list, `help` would write out all of every class and function. Without one,
        # `from mishutter import *`, which asks for it first, takes the names that are imported.
        for each in _names:
            _get(each)
    near = _difflib.get_close_matches(name, _names, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
