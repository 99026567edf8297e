/PROG  REGISTERS
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "with registers";
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
/MN
   1:  R[1]=R[1]+1 ;
   2:  PR[3]=P[2] ;
   3:  PR[3,3]=PR[3,3]+50 ;
   4:  IF R[1]>10,JMP LBL[9] ;
   5:J P[1] R[2]% FINE     ;
   6:L P[2] R[3]mm/sec CNT R[4]     ;
   7:L PR[3] 100mm/sec FINE     ;
   8:  LBL[9] ;
   9:L P[3] 100mm/sec FINE TA    .20sec,DO[3]=ON     ;
/POS
P[1]{
   GP1:
	UF : 2, UT : 3,		<10|gripper|table>
};
P[2]{
   GP1:
	UF : 2, UT : 3,		<11|gripper|table>
};
P[3]{
   GP1:
	UF : 2, UT : 3,		<12|gripper|table>
};
/END
