/PROG  ARCWELD
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "seam 3";
PROG_SIZE	= 812;
CREATE		= DATE 22-11-03  TIME 14:12:10;
MODIFIED	= DATE 23-01-09  TIME 07:45:56;
FILE_NAME	= ;
VERSION		= 0;
LINE_COUNT	= 9;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      TASK_PRIORITY	= 50,
      TIME_SLICE	= 0,
      BUSY_LAMP_OFF	= 0,
      ABORT_REQUEST	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
  ARC_WELDER ;
  WELD_SCHEDULES : 1 ;
/MN
   1:J P[1] 100% CNT100  ;
   2:L P[2] 50cm/min FINE     ;
   3:  Arc Start[1] ;
   4:  Weave Sine[1] ;
   5:L P[3] WELD_SPEED CNT100     ;
   6:C P[4]
    :  P[5] WELD_SPEED CNT100     ;
   7:  Arc End[1] ;
   8:  Weave End ;
   9:A P[6] 100mm/sec FINE     ;
/POS
P[1]{
   GP1:
	UF : 1, UT : 2,		<4|torch|fixture>
};
P[2]{
   GP1:
	UF : 1, UT : 2,		<5|torch|fixture>
};
P[3]{
   GP1:
	UF : 1, UT : 2,		<6|torch|fixture>
};
P[4]{
   GP1:
	UF : 1, UT : 2,		<7|torch|fixture>
};
P[5]{
   GP1:
	UF : 1, UT : 2,		<8|torch|fixture>
};
P[6]{
   GP1:
	UF : 1, UT : 2,		<9|torch|fixture>
};
/END
