// SPDX-License-Identifier: Apache-2.0
// Behavioural models of the ECP5 primitives that the boards use, for simulation of a whole
// generated top. Function and clock relations follow Lattice FPGA-TN-02200 (sysCLOCK PLL/DLL) and
// FPGA-TN-02035 (high-speed I/O interface, GDDRX2). The only delays are those of DELAYF and DTR.

// State of the PLL as the testbench wants it: 0 works, 1 loses lock and goes on oscillating, 2
// loses lock and stops.
import "DPI-C" function int pll_mode();

module EHXPLLL #(
    parameter integer CLKI_DIV = 1,
    parameter integer CLKFB_DIV = 1,
    parameter integer CLKOP_DIV = 8,
    parameter integer CLKOS_DIV = 8,
    parameter CLKOP_ENABLE = "ENABLED",
    parameter CLKOS_ENABLE = "DISABLED",
    parameter integer CLKOP_CPHASE = 0,
    parameter integer CLKOP_FPHASE = 0,
    parameter integer CLKOS_CPHASE = 0,
    parameter integer CLKOS_FPHASE = 0,
    parameter FEEDBK_PATH = "CLKOP",
    parameter INTFB_WAKE = "DISABLED",
    parameter DPHASE_SOURCE = "DISABLED",
    parameter OUTDIVIDER_MUXA = "DIVA",
    parameter OUTDIVIDER_MUXB = "DIVB",
    parameter OUTDIVIDER_MUXC = "DIVC",
    parameter OUTDIVIDER_MUXD = "DIVD",
    parameter PLLRST_ENA = "DISABLED",
    parameter STDBY_ENABLE = "DISABLED"
) (
    input CLKI, CLKFB, RST, STDBY,
    input PHASESEL0, PHASESEL1, PHASEDIR, PHASESTEP, PHASELOADREG, PLLWAKESYNC, ENCLKOP,
    output reg CLKOP, CLKOS, LOCK
);
    // the loop makes CLKOP = CLKI * CLKFB_DIV / CLKI_DIV; the oscillator runs CLKOP_DIV faster
    localparam integer LOCK_HALVES = 1600;
    longint last_edge, period, half, vco_khz;
    integer edges, steady, halves;

    initial begin
        CLKOP = 0; CLKOS = 0; LOCK = 0;
        last_edge = 0; period = 0; half = 0; vco_khz = 0; edges = 0; steady = 0; halves = 0;
    end

    wire stopped = RST && PLLRST_ENA == "ENABLED";

    always @(posedge CLKI) begin
        period = $time - last_edge;
        last_edge = $time;
        if (edges < 4) edges = edges + 1;
        half = period * CLKI_DIV / CLKFB_DIV / 2;
        vco_khz = 64'd500000000 / half * CLKOP_DIV;
    end

    always @(posedge stopped) begin
        LOCK = 0; CLKOP = 0; CLKOS = 0;
    end

    always begin
        if (stopped) edges = 0;
        if (edges < 4 || pll_mode() == 2 || $time - last_edge > 3 * period) begin
            LOCK = 0;
            steady = 0;
            #1000;
        end else begin
            #(half);
            // data sheet: the oscillator runs from 400 to 800 MHz
            if (pll_mode() != 0 || vco_khz < 400000 || vco_khz > 800000) begin
                LOCK = 0;
                steady = 0;
            end else if (steady < LOCK_HALVES) steady = steady + 1;
            else LOCK = 1;
            CLKOP = ~CLKOP;
            halves = halves + 1;
            if (halves >= CLKOS_DIV / CLKOP_DIV) begin
                halves = 0;
                if (CLKOS_ENABLE == "ENABLED") CLKOS = ~CLKOS;
            end
        end
    end
endmodule

module ECLKSYNCB (input ECLKI, STOP, output ECLKO);
    reg stopped = 1;
    always @(negedge ECLKI) stopped <= STOP;
    assign ECLKO = ECLKI & ~stopped;
endmodule

module CLKDIVF #(parameter DIV = "2.0") (input CLKI, RST, ALIGNWD, output reg CDIVX);
    initial CDIVX = 0;
    always @(posedge CLKI or posedge RST)
        if (RST) CDIVX <= 0;
        else CDIVX <= ~CDIVX;
    initial if (DIV != "2.0") $fatal(1, "CLKDIVF: only DIV 2.0 is modelled");
endmodule

module DCCA (input CLKI, CE, output CLKO);
    reg enabled = 0;
    always @(negedge CLKI) enabled <= CE;
    assign CLKO = CLKI & enabled;
endmodule

// A word is taken with SCLK, moved to the edge clock, and sent D0 first at both of its edges.
module ODDRX2F (input D0, D1, D2, D3, ECLK, SCLK, RST, output Q);
    reg [3:0] word = 0, moved = 0;
    reg phase = 0, second = 0, rise = 0, fall = 0;
    always @(posedge SCLK or posedge RST)
        if (RST) word <= 0;
        else word <= {D3, D2, D1, D0};
    always @(posedge ECLK or posedge RST)
        if (RST) begin
            phase <= 0;
            moved <= 0;
            second <= 0;
            rise <= 0;
        end else begin
            phase <= ~phase;
            if (phase) moved <= word;
            rise <= (phase ? moved[2] : moved[0]) ^ fall;
            second <= phase ? moved[3] : moved[1];
        end
    always @(negedge ECLK or posedge RST)
        if (RST) fall <= 0;
        else fall <= second ^ rise;
    // never two changes at one time, which a delay line could put in the wrong order
    assign Q = rise ^ fall;
endmodule

// Both edges of the edge clock are sampled; four samples go to SCLK, Q0 the earliest.
module IDDRX2F (input D, ECLK, SCLK, RST, ALIGNWD, output reg Q0, Q1, Q2, Q3);
    reg rise = 0, fall = 0;
    reg [3:0] samples = 0, word = 0;
    initial {Q3, Q2, Q1, Q0} = 0;
    always @(posedge ECLK) rise <= D;
    always @(negedge ECLK) fall <= D;
    always @(posedge ECLK) samples <= {fall, rise, samples[3:2]};
    always @(posedge SCLK) word <= samples;
    always @(posedge SCLK) {Q3, Q2, Q1, Q0} <= word;
endmodule

// A fixed delay; what it adds to data and clock is in the vendor's setup and hold times.
module DELAYG #(parameter DEL_MODE = "USER_DEFINED", parameter integer DEL_VALUE = 0)
    (input A, output Z);
    assign Z = A;
endmodule

// A delay line of 128 settings with the nominal step and without a delay of its own: loaded with
// DEL_VALUE while LOADN is low, moved by the end of a pulse of MOVE, longer while DIRECTION is low.
module DELAYF #(parameter DEL_MODE = "USER_DEFINED", parameter integer DEL_VALUE = 0)
    (input A, LOADN, MOVE, DIRECTION, output reg Z, output CFLAG);
    localparam integer STEP_PS = 25;
    integer setting;
    initial begin
        // what it is before the first load is not stated: not 0, so that a missing load is seen
        setting = 64;
        Z = 0;
    end
    always @(posedge LOADN) setting = DEL_VALUE;
    always @(negedge MOVE)
        if (DIRECTION && setting > 0) setting = setting - 1;
        else if (!DIRECTION && setting < 127) setting = setting + 1;
    assign CFLAG = DIRECTION ? setting == 0 : setting == 127;
    always @(A) Z <= #((LOADN ? setting : DEL_VALUE) * STEP_PS) A;
    initial if (DEL_MODE != "USER_DEFINED") $fatal(1, "DELAYF: only USER_DEFINED is modelled");
endmodule

// A clock of the same frequency with D0 = 1 and D1 = 0.
module ODDRX1F (input D0, D1, SCLK, RST, output Q);
    reg rise = 0, fall = 0;
    always @(posedge SCLK) begin
        rise <= D0;
        fall <= D1;
    end
    assign Q = SCLK ? rise : fall;
endmodule

module IB (input I, output O);
    assign O = I;
endmodule

// A released pin is low: its pull-down is on.
module OBZ (input I, T, output O);
    assign O = T ? 1'b0 : I;
endmodule

// The temperature sensor, by FPGA-TN-02210. A measurement takes some time, in which no code is valid.
module DTR #(
    parameter integer CODE = 33  // 70 degrees Celsius
) (
    input STARTPULSE,
    output DTROUT7, DTROUT6, DTROUT5, DTROUT4, DTROUT3, DTROUT2, DTROUT1, DTROUT0
);
    reg valid = 0;
    assign DTROUT7 = valid;
    assign {DTROUT6, DTROUT5, DTROUT4, DTROUT3, DTROUT2, DTROUT1, DTROUT0} = valid ? CODE[6:0] : 7'd0;
    always @(posedge STARTPULSE) begin
        valid = 0;
        #50000000 valid = 1;
    end
endmodule
