// SPDX-License-Identifier: Apache-2.0
// Behavioural models of the iCE40 primitives that the boards use, for simulation of a whole
// generated top. Function and clock relations follow Lattice FPGA-TN-02052 (sysCLOCK PLL) and the
// iCE technology library (SB_IO, SB_GB_IO); there are no delays.

// State of the PLL as the testbench wants it: 0 works, 1 loses lock and goes on oscillating, 2
// loses lock and stops.
import "DPI-C" function int pll_mode();

module SB_PLL40_2F_CORE #(
    parameter FEEDBACK_PATH = "SIMPLE",
    parameter [3:0] DIVR = 0,
    parameter [6:0] DIVF = 0,
    parameter [2:0] DIVQ = 0,
    parameter [2:0] FILTER_RANGE = 0,
    parameter PLLOUT_SELECT_PORTA = "GENCLK",
    parameter PLLOUT_SELECT_PORTB = "GENCLK"
) (
    input REFERENCECLK, RESETB, BYPASS,
    output reg PLLOUTGLOBALA, PLLOUTGLOBALB, LOCK
);
    // simple feedback: VCO = reference (DIVF + 1) / (DIVR + 1), output = VCO / 2^DIVQ
    localparam integer LOCK_HALVES = 1600;
    longint last_edge, period, half, detector_khz, vco_khz;
    integer edges, steady, range;
    reg settings_hold;

    initial begin
        PLLOUTGLOBALA = 0; PLLOUTGLOBALB = 0; LOCK = 0;
        last_edge = 0; period = 0; half = 0; edges = 0; steady = 0;
        if (FEEDBACK_PATH != "SIMPLE" || PLLOUT_SELECT_PORTA != "GENCLK"
            || PLLOUT_SELECT_PORTB != "GENCLK_HALF")
            $fatal(1, "SB_PLL40_2F_CORE: only simple feedback, GENCLK and GENCLK_HALF are modelled");
    end

    always @(posedge REFERENCECLK) begin
        period = $time - last_edge;
        last_edge = $time;
        if (edges < 4) edges = edges + 1;
        half = period * (64'(DIVR) + 1) * (64'd1 << DIVQ) / (64'(DIVF) + 1) / 2;
        detector_khz = 64'd1000000000 / period / (64'(DIVR) + 1);
        vco_khz = detector_khz * (64'(DIVF) + 1);
        // the filter's setting for the frequency of the phase detector
        range = 1 + (detector_khz >= 17000) + (detector_khz >= 26000) + (detector_khz >= 44000)
            + (detector_khz >= 66000) + (detector_khz >= 101000);
        // data sheet: detector 10 to 133 MHz, oscillator 533 to 1066 MHz, output 16 to 275 MHz
        settings_hold = detector_khz >= 9990 && detector_khz <= 133100 && vco_khz >= 532500
            && vco_khz <= 1066500 && half >= 1818 && half <= 31250
            && 32'(FILTER_RANGE) == range && DIVQ >= 1 && DIVQ <= 6;
    end

    always begin
        if (edges < 4 || !RESETB || pll_mode() == 2 || $time - last_edge > 3 * period) begin
            LOCK = 0;
            steady = 0;
            #1000;
        end else begin
            #(half);
            if (pll_mode() != 0 || !settings_hold) begin
                LOCK = 0;
                steady = 0;
            end else if (steady < LOCK_HALVES) steady = steady + 1;
            else LOCK = 1;
            PLLOUTGLOBALA = ~PLLOUTGLOBALA;
            if (PLLOUTGLOBALA) PLLOUTGLOBALB = ~PLLOUTGLOBALB;
        end
    end
endmodule

module SB_GB_IO #(parameter [5:0] PIN_TYPE = 0, parameter IO_STANDARD = "SB_LVCMOS") (
    input PACKAGE_PIN, output GLOBAL_BUFFER_OUTPUT
);
    assign GLOBAL_BUFFER_OUTPUT = PACKAGE_PIN;
    initial if (PIN_TYPE[1:0] != 2'b01) $fatal(1, "SB_GB_IO: only a plain input is modelled");
endmodule

module SB_DFF (input C, D, output reg Q);
    initial Q = 0;
    always @(posedge C) Q <= D;
endmodule

// PIN_TYPE[5:2]: how the pin is driven; PIN_TYPE[1:0]: 01 a plain input, 00 a registered one, of
// which D_IN_0 is sampled at the rising and D_IN_1 at the falling edge. A pin that is released is
// low: whoever connects an LED has a pull-down.
module SB_IO #(
    parameter [5:0] PIN_TYPE = 0,
    parameter [0:0] PULLUP = 0,
    parameter IO_STANDARD = "SB_LVCMOS"
) (
    inout PACKAGE_PIN,
    input OUTPUT_CLK, INPUT_CLK, OUTPUT_ENABLE, D_OUT_0, D_OUT_1,
    output D_IN_0, D_IN_1
);
    localparam [3:0] DRIVE = PIN_TYPE[5:2];
    initial
        if (!(DRIVE inside {4'b0000, 4'b0110, 4'b1010, 4'b0100, 4'b1000, 4'b1100}))
            $fatal(1, "SB_IO: PIN_TYPE %b is not modelled", PIN_TYPE);
    reg rise = 0, fall = 0, enabled = 0, in_rise = 0, in_fall = 0;
    always @(posedge OUTPUT_CLK) begin
        rise <= D_OUT_0;
        enabled <= OUTPUT_ENABLE;
    end
    always @(negedge OUTPUT_CLK) fall <= D_OUT_1;
    always @(posedge INPUT_CLK) in_rise <= PACKAGE_PIN;
    always @(negedge INPUT_CLK) in_fall <= PACKAGE_PIN;
    generate
        case (DRIVE)
            4'b0110: assign PACKAGE_PIN = D_OUT_0;
            4'b1010: assign PACKAGE_PIN = OUTPUT_ENABLE ? D_OUT_0 : 1'bz;
            4'b0100: assign PACKAGE_PIN = OUTPUT_CLK ? rise : fall;
            4'b1000: assign PACKAGE_PIN = OUTPUT_ENABLE ? (OUTPUT_CLK ? rise : fall) : 1'bz;
            4'b1100: assign PACKAGE_PIN = enabled ? (OUTPUT_CLK ? rise : fall) : 1'bz;
            default: ;  // an input
        endcase
        if (PIN_TYPE[1:0] == 2'b00) begin
            assign D_IN_0 = in_rise;
            assign D_IN_1 = in_fall;
        end else if (PIN_TYPE[1:0] == 2'b01) begin
            assign D_IN_0 = PACKAGE_PIN;
            assign D_IN_1 = 1'b0;
        end else initial $fatal(1, "SB_IO: PIN_TYPE %b is not modelled", PIN_TYPE);
    endgenerate
endmodule
